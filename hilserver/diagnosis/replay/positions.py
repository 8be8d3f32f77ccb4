"""What is known of the navigation's positions before anything is replayed."""

from typing import Final

import numpy as np

from hilserver.diagnosis.catalogue.candidate import Region
from hilserver.measured.channels import POSITION
from hilserver.measured.data import Channel, MeasuredLog

SAME_START_M: Final = 0.01
FEWEST_STARTS: Final = 4
FEW: Final = 0.02  # share of the samples that a driven place may leave out on each side


def begins_anew(log: MeasuredLog) -> bool:
    """Return whether the navigation's frame begins anew with every segment.

    Place and heading in the room are not known then.
    """
    if not log.has(*POSITION) or len(log.spans) < FEWEST_STARTS:
        return False
    starts = []
    for name in POSITION:
        channel = log[name]
        _, first = np.unique(channel.span, return_index=True)
        starts.append(channel.values[first])
    return all(len(s) >= FEWEST_STARTS and float(np.ptp(s)) < SAME_START_M for s in starts)


def driven_place(log: MeasuredLog) -> Region | None:
    """Return where the robot drove, x_min, x_max, y_min, y_max, but for a few samples."""
    if not log.has(*POSITION):
        return None
    x, y = (log[n].values for n in POSITION)
    (a, b), (c, d) = (np.quantile(v, [FEW, 1.0 - FEW]) for v in (x, y))
    return float(a), float(b), float(c), float(d)


def paired(log: MeasuredLog) -> MeasuredLog:
    """Return the log with only those positions that have both coordinates."""
    if not log.has(*POSITION):
        return log
    x, y = (log[n] for n in POSITION)
    keys = [c.span * 1e7 + c.t_s for c in (x, y)]
    both = np.intersect1d(keys[0], keys[1])
    kept = {}
    for name, c, key in zip(POSITION, (x, y), keys, strict=True):
        rows = np.isin(key, both)
        kept[name] = Channel(c.t_s[rows], c.values[rows], c.span[rows])
    return log.with_channels(kept)

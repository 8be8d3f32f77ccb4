"""What is known of the navigation's positions before any replay."""

from typing import Final

import numpy as np

from hilserver.diagnosis.catalogue.candidate import Region
from hilserver.diagnosis.checks.support import along, row_period_s, subset
from hilserver.diagnosis.thresholds import HALF
from hilserver.measured.channels import POSITION
from hilserver.measured.data import MeasuredLog

SAME_START_M: Final = 0.01
FEWEST_STARTS: Final = 4
# share of the samples that the driven area may leave out on each side
FEW: Final = 0.02


def begins_anew(log: MeasuredLog) -> bool:
    """Return whether the navigation's frame begins anew with every segment.

    Then place and heading in the room are not known.
    """
    if not log.has(*POSITION) or len(log.spans) < FEWEST_STARTS:
        return False
    starts = []
    for name in POSITION:
        channel = log[name]
        _, first = np.unique(channel.span, return_index=True)
        starts.append(channel.values[first])
    return all(
        len(s) >= FEWEST_STARTS and float(np.ptp(s)) < SAME_START_M for s in starts
    )


def driven_place(log: MeasuredLog) -> Region | None:
    """Return the area the robot drove in, x_min, x_max, y_min, y_max, except for a few samples."""
    if not log.has(*POSITION):
        return None
    x, y = (log[n].values for n in POSITION)
    (a, b), (c, d) = (np.quantile(v, [FEW, 1.0 - FEW]) for v in (x, y))
    return float(a), float(b), float(c), float(d)


def paired(log: MeasuredLog) -> MeasuredLog:
    """Return the log with only those positions that have both coordinates.

    If they come in separate rows, the second is interpolated at the time of the first, unless it
    was missing for more than a row or two.
    """
    if not log.has(*POSITION):
        return log
    start_s = np.array([span.start_s for span in log.spans])
    x, y = (log[n] for n in POSITION)
    at, own = along(x, start_s), along(y, start_s)
    both = np.isin(at, own)
    if not len(y) or both.sum() > HALF * min(len(x), len(y)):
        return log.with_channels(
            {POSITION[0]: subset(x, both), POSITION[1]: subset(y, np.isin(own, at))}
        )
    after = np.clip(np.searchsorted(own, at), 1, len(own) - 1)
    between = (y.span[after] == x.span) & (y.span[after - 1] == x.span)
    for since_s in (at - own[after - 1], own[after] - at):
        between &= (since_s >= 0.0) & (since_s < 2.0 * row_period_s(y))
    x = subset(x, between)
    return log.with_channels(
        {
            POSITION[0]: x,
            POSITION[1]: x.with_values(np.interp(at[between], own, y.values)),
        }
    )

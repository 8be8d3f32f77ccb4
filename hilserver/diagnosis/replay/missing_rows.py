"""Rows that are missing from a log: no replay knows the set-points of the drive there."""

from collections.abc import Sequence

import numpy as np

from hilserver.diagnosis.checks.support import along, row_period_s, subset
from hilserver.diagnosis.thresholds import HALF, LOST_SEEN_S, NEARLY_ALL
from hilserver.measured.data import MeasuredLog


def without_unknown_commands(
    log: MeasuredLog, commands: Sequence[str], judged: Sequence[str]
) -> MeasuredLog:
    """Return a log without the samples that answer commands of missing rows.

    While a command stays the same, nothing is unknown. A log whose commands have no clock, or in
    which most samples would go, is returned as it is.
    """
    begins, ends = [np.empty(0)], [np.empty(0)]
    for name in commands:
        command, at_s = log[name], along(log[name])
        steps_s = np.where(np.diff(command.span) == 0, np.diff(at_s), 0.0)
        is_long = steps_s > 1.5 * row_period_s(command)
        if (~is_long).sum() < NEARLY_ALL * len(is_long):
            return log
        unknown = is_long & (np.diff(command.values) != 0.0)
        begins.append(at_s[:-1][unknown])
        ends.append(at_s[1:][unknown] + LOST_SEEN_S)
    begin_s, end_s = (np.sort(np.concatenate(some)) for some in (begins, ends))

    kept = {}
    for name in judged:
        at_s = along(log[name])
        begun = np.searchsorted(begin_s, at_s)
        known = begun == np.searchsorted(end_s, at_s)
        if known.sum() < HALF * len(known):
            return log
        kept[name] = subset(log[name], known)
    return log.with_channels(kept)

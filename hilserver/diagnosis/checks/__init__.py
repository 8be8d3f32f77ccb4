"""Data checks: faults of the log itself, found without the model and removed from the data.

Each check takes a log and returns the corrected log and what it found. Their order matters, because
units and signs can only be judged on real samples.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.catalogue.traits import traits_of
from hilserver.diagnosis.checks import (
    angles,
    blocked,
    clocks,
    copied,
    dropouts,
    limited,
    markers,
    messages,
    orientation,
    repetitions,
    setpoint_runs,
    too_fast,
    units,
)
from hilserver.diagnosis.schema.findings import Finding
from hilserver.measured.data import MeasuredLog
from hilserver.measured.names import is_input
from hilserver.plant.parameters import RobotParameters

FAR_S = 1e5
"""Later stamps are seconds since some epoch; they are counted from the start of each span."""

Check = Callable[[MeasuredLog, RobotParameters], tuple[MeasuredLog, list[Finding]]]

ORDER: Final[tuple[Check, ...]] = (
    markers.find,
    repetitions.find_stuck,
    copied.find,
    setpoint_runs.find_interpolated,
    dropouts.find_missing,
    messages.find,
    repetitions.find_held,
    dropouts.find_repeated,
    angles.find,
    units.find,
    too_fast.find,
    orientation.find,
    blocked.find,
    limited.find,
    setpoint_runs.find_sparse,
    clocks.find,
)


@dataclass(frozen=True)
class Checked:
    """A log after the data checks."""

    log: MeasuredLog  # without the faults that were found
    # each with verdict ``data_fault``; `regressors` names the channels concerned
    findings: tuple[Finding, ...]

    @property
    def lost_setpoints(self) -> bool:
        """Whether the log no longer shows when the set-points changed."""
        return any(
            traits_of(cause).hides_inputs and any(map(is_input, finding.regressors))
            for finding in self.findings
            for cause in finding.causes
        )


def check(log: MeasuredLog, robot: RobotParameters) -> Checked:
    """Find the faults of the log and remove them.

    Parameters
    ----------
    robot : RobotParameters
        Configured dimensions and signs of the machine.
    """
    findings: list[Finding] = []
    far = max((abs(span.end_s) for span in log.spans), default=0.0) > FAR_S
    start_s = (
        np.array([span.start_s for span in log.spans])
        if far
        else np.zeros(len(log.spans))
    )
    log = _moved(log, -start_s)
    for find in ORDER:
        log, found = find(log, robot)
        findings += found
    return Checked(_moved(log, start_s), tuple(findings))


def _moved(log: MeasuredLog, by_s: Array) -> MeasuredLog:
    """Return the log with the stamps of each span shifted."""
    if not by_s.any():
        return log
    channels = {
        name: replace(channel, t_s=channel.t_s + by_s[channel.span])
        for name, channel in log.channels.items()
    }
    spans = tuple(
        replace(span, start_s=span.start_s + by, end_s=span.end_s + by)
        for span, by in zip(log.spans, by_s.tolist(), strict=True)
    )
    return replace(log, channels=channels, spans=spans)

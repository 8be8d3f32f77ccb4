"""A machine that stood still: what its recording can show and what it cannot."""

from collections.abc import Sequence

import numpy as np

from hilserver.diagnosis.catalogue.traits import traits_of
from hilserver.diagnosis.schema.findings import Detectable, Finding, NotJudged, Verdict
from hilserver.diagnosis.thresholds import STILL_RPM
from hilserver.measured.channels import SETPOINTS, SPEEDS, TWIST
from hilserver.measured.data import MeasuredLog


def stood_still(log: MeasuredLog) -> bool:
    """Return whether no wheel turned and none was asked to turn."""
    speeds = [log[name].values for name in SPEEDS if name in log]
    asked = [log[name].values for name in (*SETPOINTS, *TWIST) if name in log]
    if not any(map(len, speeds)) or any(values.any() for values in asked):
        return False
    return all(np.quantile(np.abs(v), 0.99) < STILL_RPM for v in speeds if len(v))


def too_little_motion() -> Finding:
    """Return the finding of a recording without any motion."""
    return Finding(
        verdict=Verdict.INSUFFICIENT_EXCITATION,
        causes=(),
        block="drive",
        explanation="The robot stood still for the whole recording: its drive, kinematics and"
        " navigation cannot be judged.",
        separating_experiment="Record a drive with straight runs at several speeds, turns in"
        " both directions and stops; `hilserver plan` lists what such a drive can show.",
    )


def at_rest(
    sizes: Sequence[Detectable], unseen: Sequence[NotJudged]
) -> tuple[list[Detectable], list[NotJudged]]:
    """Return what can and cannot be seen of a machine at rest.

    The noise of the wheel speeds moves a simulated pose; that is not an effect that could be seen.
    """
    shown = [size for size in sizes if traits_of(size.cause).at_rest]
    causes = [s.cause for s in sizes if s not in shown] + [u.cause for u in unseen]
    return shown, [
        NotJudged(cause=cause, reason="the robot stood still") for cause in causes
    ]

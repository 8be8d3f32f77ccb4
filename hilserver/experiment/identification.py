"""What section 5.2 identifies, from a recording of its drives, beside what it printed."""

from collections.abc import Callable
from typing import Final, NamedTuple

from hilserver.errors import LogError
from hilserver.experiment.thesis import Experiment
from hilserver.identify.consistency import check_sides, check_sign
from hilserver.identify.rotation import identify_rotation
from hilserver.identify.step_response import identify_steps
from hilserver.identify.text import number
from hilserver.measured.data import MeasuredLog
from hilserver.plant.parameters import RobotParameters

TABLE_5_1: Final = (
    "tile 1.052, floating floor 1.019, hard carpet 1.036, soft carpet 1.030"
)
ANSWERS: Final = {True: "yes", False: "no", None: "cannot tell"}


class FigureRow(NamedTuple):
    """One figure: what it is, what this recording shows, what the thesis printed."""

    what: str
    here: str
    printed: str


class Identified(NamedTuple):
    """The table, and what makes its values doubtful."""

    rows: list[FigureRow]
    doubts: list[str]


def identify(
    experiment: Experiment, log: MeasuredLog, robot: RobotParameters
) -> Identified:
    """Return front = rear, sign, K_om and the drive; what a log cannot show says why."""
    parts: list[Callable[[], Identified]] = []
    if experiment.identifies:
        parts.append(lambda: of_turning(log, robot))
    if experiment.name == "5.2.2":
        parts.append(lambda: of_drive(log))
    found = Identified([], [])
    for part in parts:
        try:
            rows, doubts = part()
        except LogError as error:
            rows = []
            doubts = [str(error)]
        found.rows.extend(rows)
        found.doubts.extend(doubts)
    return found


def of_turning(log: MeasuredLog, robot: RobotParameters) -> Identified:
    """Return front = rear, sign and K_om."""
    rows = []
    gain = identify_rotation(log, robot)
    left, right = check_sides(log)
    for check, figure in ((left, "5.4"), (right, "5.8")):
        answer = f"{ANSWERS[check.passed]}: {check.text}"
        rows.append(FigureRow(check.name, answer, f"yes (figure {figure})"))

    sign = check_sign(gain)
    answer = f"{ANSWERS[sign.passed]}: {sign.text}"
    negative = "K_om is negative with the yaw sign of (5.5) to (5.7)"
    rows.append(FigureRow("sign", answer, negative))

    unsteady = number(gain.unsteady)
    steady = number(gain.steady)
    rows.append(
        FigureRow("K_om by (5.19), all samples", unsteady, f"table 5.1: {TABLE_5_1}")
    )
    rows.append(FigureRow("K_om, steady speeds only", steady, "5.2.2: 1.12"))
    rows.append(
        FigureRow(
            "K_om of the model", f"{gain.configured:.4g} 1/m", "(5.9), (5.22): 1.995"
        )
    )
    lag = number(gain.lag_s, scale=1e3, unit="ms")
    rows.append(FigureRow("turn rate behind the wheels", lag, "not considered"))
    return Identified(rows, list(gain.flags))


def of_drive(log: MeasuredLog) -> Identified:
    """Return what Strejc's method and least squares make of steps."""
    steps = identify_steps(log)
    order = "below 2: two time constants"
    if steps.strejc.order > 1:
        order = f"{steps.strejc.order}, T {steps.strejc.time_constant_s:.3g} s"
    t1, t2 = (number(t, scale=1e3, unit="ms") for t in (steps.t1, steps.t2))
    doubts = list(steps.flags)

    if steps.input != "duty_pct":
        of = "closed loop, from steps of the set-point"
        printed = ("", "", "", "")
    else:
        of = "drive, from steps of the duty"
        printed = ("2 (5.23)", "69 ms (5.23)", "2.3 ms (5.23)", "1.11 (5.23)")
        doubts.append(
            "(5.23) has no load. A drive that moves the robot also accelerates its mass, so T1 is"
            " longer than with the wheels in the air (7.3)."
        )
    names = ("order by Strejc's method", "T1", "T2", "gain")
    here = (order, t1, t2, number(steps.gain))
    rows = [
        FigureRow(f"{of}: {name}", value, other)
        for name, value, other in zip(names, here, printed, strict=True)
    ]
    return Identified(rows, doubts)

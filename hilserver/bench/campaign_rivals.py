"""What rivals of the diagnosis say of the logs of the campaign, beside its own answer."""

from dataclasses import asdict
from typing import Any

from hilserver_injector.cases import Case

from hilserver.bench import sysid
from hilserver.measured.data import MeasuredLog
from hilserver.plant.parameters import RobotParameters


def require() -> None:
    """Ask for every library that a rival needs.

    Raises
    ------
    FailedError
        If one of them is not installed.
    """
    sysid.library()


def answers(case: Case, log: MeasuredLog, robot: RobotParameters) -> dict[str, Any]:
    """Return the answer of every rival that has one, as plain data by its name."""
    found: dict[str, Any] = {}
    if case.group == "single":
        values = sysid.fitted(case, log, robot)
        found["sysid"] = {name: asdict(value) for name, value in values.items()}
    return found

"""A manoeuvre: set-points of the four wheels over time, from a log or scenario, to a scenario."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from hilserver.arrays import Array
from hilserver.config.loading import place
from hilserver.errors import ConfigError, LogError
from hilserver.faults.scenario import Scenario, load_scenario
from hilserver.measured.channels import SETPOINTS
from hilserver.measured.data import MeasuredLog
from hilserver.plant.packing import pack
from hilserver.plant.parameters import RobotParameters

TWIST: Final = ("twist.linear_m_s", "twist.angular_rad_s")
ALL_WHEELS: Final = "wheels.setpoints_rpm"
MODE, ENABLE = "control.mode", "drive.enable"
AFTER_S: Final = 1.0  # how long a scenario is observed after its last step
LONGEST_PLAN_S: Final = 3600.0
SHORTEST_S: Final = 2.0


@dataclass(frozen=True)
class Manoeuvre:
    """Set-points that hold until the next ones; the robot is at rest beforehand."""

    at_s: Array  # shape (k,): rising, the first is 0
    # shape (k, 4): fl, rl, fr, rr with the plant's signs: driving forward is left > 0, right < 0
    setpoints_rpm: Array
    duration_s: float  # not before the last change

    def then(self, other: "Manoeuvre") -> "Manoeuvre":
        """Return this manoeuvre followed by another."""
        return Manoeuvre(
            np.concatenate([self.at_s, self.duration_s + other.at_s]),
            np.vstack([self.setpoints_rpm, other.setpoints_rpm]),
            self.duration_s + other.duration_s,
        )

    def changes(self) -> "Manoeuvre":
        """Return the same manoeuvre without rows that change nothing."""
        moved = (np.diff(self.setpoints_rpm, axis=0) != 0.0).any(axis=1)
        keep = np.concatenate([[True], moved])
        return Manoeuvre(self.at_s[keep], self.setpoints_rpm[keep], self.duration_s)

    def held(self, t_s: Array) -> Array:
        """Return the set-points that hold at these times, shape (n, 4)."""
        row = np.searchsorted(self.at_s, t_s + 1e-9, side="right") - 1
        return np.asarray(self.setpoints_rpm[np.maximum(row, 0)])


def of_log(log: MeasuredLog, robot: RobotParameters) -> list[Manoeuvre]:
    """Return the manoeuvre of every span of a log.

    Raises
    ------
    LogError
        If the log has no set-points, or is too short or too long.
    """
    names = SETPOINTS if log.has(*SETPOINTS) else TWIST
    if not log.has(*names):
        raise LogError(
            f"{_files(log)}: contains no set-points; known columns are {SETPOINTS[0]} ..."
            f" {SETPOINTS[-1]}, or"
            f" {TWIST[0]} with {TWIST[1]}"
        )
    found = []
    for i, span in enumerate(log.spans):
        t = np.unique(
            np.concatenate([log[n].of(i)[0] for n in (*names, ENABLE) if n in log])
        )
        t = np.concatenate([[span.start_s], t[t > span.start_s]])
        columns = {n: _hold(*log[n].of(i), t) for n in (*names, ENABLE) if n in log}
        rpm = _to_wheels(columns, robot, names is TWIST)
        found.append(
            Manoeuvre(t - span.start_s, rpm, span.end_s - span.start_s).changes()
        )
    total_s = sum(m.duration_s for m in found)
    if not SHORTEST_S <= total_s <= LONGEST_PLAN_S:
        raise LogError(
            f"{_files(log)}: lasts {total_s:.3g} s; a plan needs {SHORTEST_S:g} to"
            f" {LONGEST_PLAN_S:g} s"
        )
    return found


def _files(log: MeasuredLog) -> str:
    return ", ".join(source.file for source in log.sources)


def _hold(t: Array, values: Array, at: Array) -> Array:
    if len(t) == 0:
        return np.zeros(len(at))
    return np.asarray(
        values[np.maximum(np.searchsorted(t, at + 1e-9, side="right") - 1, 0)]
    )


def _to_wheels(
    columns: Mapping[str, Array], robot: RobotParameters, is_twist: bool
) -> Array:
    if is_twist:
        rpm = from_twist(robot, columns[TWIST[0]], columns[TWIST[1]])
    else:
        rpm = np.column_stack([columns[n] for n in SETPOINTS])
    if ENABLE in columns:
        rpm = rpm * (columns[ENABLE][:, None] > 0.5)
    return np.asarray(rpm)


def from_twist(
    robot: RobotParameters, linear_m_s: Array, angular_rad_s: Array
) -> Array:
    """Return the set-points of a twist, equation (5.25), shape (n, 4) [rpm]."""
    p = pack(robot)
    if robot.exclusive_twist:
        straight_on = np.abs(linear_m_s) >= np.abs(angular_rad_s) * p.half_track
        linear_m_s = np.where(straight_on, linear_m_s, 0.0)
        angular_rad_s = np.where(straight_on, 0.0, angular_rad_s)
    straight, turning = linear_m_s * p.rpm_per_m_s, angular_rad_s * p.rpm_per_rad_s
    left, right = turning + straight, turning - straight
    return np.column_stack([left, left, right, right])


def of_scenario(
    path: Path, robot: RobotParameters, duration_s: float | None = None
) -> list[Manoeuvre]:
    """Return the manoeuvre that a scenario's steps command; its faults are left out.

    Raises
    ------
    ConfigError
        If it is not a scenario, has no set-points, or is too long.
    """
    scenario = load_scenario(path)
    now: dict[str, float] = dict.fromkeys((*SETPOINTS, *TWIST, MODE), 0.0) | {
        ENABLE: 1.0
    }
    at_s, rpm = [0.0], [np.zeros(4)]
    commands = False
    for index, step in sorted(
        enumerate(scenario.steps), key=lambda entry: entry[1].at_s
    ):
        written = _scalars(
            step.write, place(path, ("steps", index, "write", ALL_WHEELS))
        )
        commands |= any(name in now and name not in (MODE, ENABLE) for name in written)
        now |= {name: value for name, value in written.items() if name in now}
        at_s.append(step.at_s)
        rpm.append(_present(now, robot))
    if not commands:
        raise ConfigError(
            f"{path}: writes no set-points; a plan needs {ALL_WHEELS} or a twist"
        )
    last_s = at_s[-1] + AFTER_S if duration_s is None else max(duration_s, at_s[-1])
    if not SHORTEST_S <= last_s <= LONGEST_PLAN_S:
        raise ConfigError(
            f"{path}: lasts {last_s:.3g} s; a plan needs {SHORTEST_S:g} to {LONGEST_PLAN_S:g} s"
        )
    return [_last_of_each(np.array(at_s), np.array(rpm), last_s).changes()]


def _scalars(write: Mapping[str, Any], where: str) -> dict[str, float]:
    found: dict[str, float] = {}
    for name, value in write.items():
        if name == ALL_WHEELS:
            if not isinstance(value, list) or len(value) != len(SETPOINTS):
                raise ConfigError(
                    f"{where}a list of {len(SETPOINTS)} set-points belongs here"
                )
            found |= dict(zip(SETPOINTS, value, strict=True))
        elif not isinstance(value, list):
            found[name] = float(value)
    return found


def _present(now: Mapping[str, float], robot: RobotParameters) -> Array:
    columns = {name: np.array([value]) for name, value in now.items()}
    return np.asarray(_to_wheels(columns, robot, now[MODE] > 0.5)[0])


def _last_of_each(at_s: Array, rpm: Array, duration_s: float) -> Manoeuvre:
    """Keep the last of several rows at one time."""
    keep = np.append(np.diff(at_s) > 0.0, True)
    return Manoeuvre(at_s[keep], rpm[keep], duration_s)


def as_scenario(spans: Sequence[Manoeuvre], text: str) -> dict[str, Any]:
    """Return a scenario, as plain data, that plays manoeuvres one after the other."""
    whole = spans[0]
    for span in spans[1:]:
        whole = whole.then(span)
    whole = whole.changes()
    steps: list[dict[str, Any]] = []
    for at_s, rpm in zip(
        whole.at_s.tolist(), whole.setpoints_rpm.tolist(), strict=True
    ):
        write: dict[str, Any] = {ALL_WHEELS: [round(v, 4) + 0.0 for v in rpm]}
        if not steps:
            write = {MODE: 0, ENABLE: True} | write
        steps.append({"at_s": round(at_s, 4), "write": write})
    if whole.setpoints_rpm[-1].any():
        steps.append(
            {"at_s": round(whole.duration_s, 4), "write": {ALL_WHEELS: [0.0] * 4}}
        )
    Scenario.model_validate({"steps": steps})
    return {"scenario": text, "steps": steps}

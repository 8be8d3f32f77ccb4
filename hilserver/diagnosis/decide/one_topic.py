"""Wheels recorded from one topic, mapped as set-points and as speeds: the motion decides which.

Set-points drive the plant's own loop, and the robot follows it: late and with its overshoot. Actual
speeds move the robot at once.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.checks import Checked, check
from hilserver.diagnosis.checks.support import along, largest, slope_of
from hilserver.diagnosis.replay.drive_stage import DriveStage
from hilserver.diagnosis.thresholds import (
    BLOCK_S,
    FEWEST_BLOCKS,
    FEWEST_SAMPLES,
    ONE_TOPIC_LEAST,
    ONE_TOPIC_MOST,
    ONE_TOPIC_PIECE_S,
    ONE_TOPIC_TURN_S,
    RIVAL_CLEAR_Z,
)
from hilserver.measured.channels import GYRO, SETPOINTS, SPEEDS, YAW
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.plant.packing import pack
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.units import RAD_S_PER_RPM


class Leaning(NamedTuple):
    """How much of the way from speeds (0) to set-points (1) the motion shows."""

    value: float
    sd: float
    # measured turn over that of the configured kinematics
    if_speeds: float
    if_sent: float

    @property
    def reading(self) -> int | None:
        """The reading that is nearer if the other is clearly wrong; None if neither is clear."""
        nearer = 1 if self.value > 0.5 else 0
        is_clear = abs(self.value - (1 - nearer)) > RIVAL_CLEAR_Z * self.sd
        return (
            nearer
            if is_clear and ONE_TOPIC_LEAST < self.value < ONE_TOPIC_MOST
            else None
        )


def checked(log: MeasuredLog, robot: RobotParameters) -> Checked:
    """Check a log; of wheels that come from one topic, decide what they are."""
    found = check(log, robot)
    if not _from_one_topic(log) or not found.log.has(*SETPOINTS):
        return found
    speeds = {b: found.log[a] for a, b in zip(SETPOINTS, SPEEDS, strict=True)}
    shown = found.log.without(SETPOINTS).with_channels(speeds)
    share = (
        _share(shown, _replayed(found.log, robot), robot)
        if log.drive_is_known
        else None
    )
    if share is None:
        return found
    topic = "the wheels were mapped as set-points and as speeds from one topic"
    if share.reading == 0:
        note = (
            f"{topic}: the robot turned as they did, not later: "
            "they were judged as actual speeds"
        )
        findings = [
            f for f in found.findings if f.causes != ("setpoint_as_measurement",)
        ]
        return Checked(_with(shown, note), tuple(findings))
    if share.reading == 1:
        note = (
            f"{topic}: the robot turned as the drive does that receives them: they were judged as"
            " set-points, and the kinematics behind the configured drive"
        )
        return replace(found, log=_with(found.log.without(SPEEDS), note))
    note = (
        f"{topic}, and the motion does not show which they are: the robot turned"
        f" {share.if_sent:.3g} times as far as configured if they are set-points, as which they"
        f" were judged, and {share.if_speeds:.3g} times if they are speeds"
    )
    return replace(found, log=_with(found.log.without(SPEEDS), note))


def _with(log: MeasuredLog, note: str) -> MeasuredLog:
    return replace(log, notices=(*log.notices, note))


def _from_one_topic(log: MeasuredLog) -> bool:
    """Return whether set-points and speeds of all wheels are the same samples."""
    return log.has(*SETPOINTS, *SPEEDS) and all(
        np.array_equal(log[a].t_s, log[b].t_s)
        and np.array_equal(log[a].values, log[b].values)
        for a, b in zip(SETPOINTS, SPEEDS, strict=True)
    )


def _replayed(log: MeasuredLog, robot: RobotParameters) -> MeasuredLog:
    """Return the log with the speeds that the configured drive makes of its set-points."""
    drive = DriveStage(log, robot, block_s=BLOCK_S)
    speed, segments = drive.simulate({})[0], drive.segments
    n = len(segments)
    t_s = np.concatenate([segments.times(i) for i in range(n)])
    span = np.repeat(segments.span, np.diff(segments.first))
    return log.with_channels(
        {name: Channel(t_s, speed[:, wheel], span) for wheel, name in enumerate(SPEEDS)}
    )


def _share(
    shown: MeasuredLog, sent: MeasuredLog, robot: RobotParameters
) -> Leaning | None:
    """Return which of both readings the measured turn follows; None if it was not measured."""
    name = GYRO if GYRO in shown else YAW
    if name not in shown or len(shown[name]) < FEWEST_SAMPLES:
        return None
    source, at = shown[name], along(shown[name])
    measured = np.unwrap(source.values) if name == YAW else _turned(source)
    start_s = np.array([span.start_s for span in shown.spans])
    inside = source.t_s - ONE_TOPIC_TURN_S > start_s[source.span]

    def turns(stamps: Array, path: Array) -> Array:
        return (
            np.interp(at, stamps, path) - np.interp(at - ONE_TOPIC_TURN_S, stamps, path)
        )[inside]

    turn, speeds, setpoints = (
        turns(at, measured),
        *(turns(*_asked(x, robot)) for x in (shown, sent)),
    )
    slope, if_sent = slope_of(turn, speeds), slope_of(turn, setpoints)
    apart, left = slope * (setpoints - speeds), turn - slope * speeds
    # wild samples count no more than the largest others
    left = np.clip(left, -largest(left), largest(left))
    _, piece = np.unique(
        (at[inside] / ONE_TOPIC_PIECE_S).astype(np.int64), return_inverse=True
    )
    weight, seen = np.bincount(piece, apart**2), np.bincount(piece, apart * left)
    n = len(weight)
    if n < 2 * FEWEST_BLOCKS or not weight.sum():
        return None
    value = float(seen.sum() / weight.sum())
    spread = float(np.sum((seen - value * weight) ** 2)) * n / (n - 1)
    return Leaning(value, float(np.sqrt(spread) / weight.sum()), slope, if_sent)


def _asked(log: MeasuredLog, robot: RobotParameters) -> tuple[Array, Array]:
    """Return stamps, and the heading that the wheels ask for."""
    p, first = pack(robot), log[SPEEDS[0]]
    radii = (p.radius_left, p.radius_left, p.radius_right, p.radius_right)
    rims = [
        0.5 * radius * np.interp(along(first), along(log[name]), log[name].values)
        for name, radius in zip(SPEEDS, radii, strict=True)
    ]
    rate = p.yaw_gain * RAD_S_PER_RPM * np.sum(rims, axis=0)
    return along(first), _turned(first.with_values(rate))


def _turned(rate: Channel) -> Array:
    """Return the integral of a rate; between spans it stands still."""
    step = np.diff(rate.t_s) * 0.5 * (rate.values[1:] + rate.values[:-1])
    step[np.diff(rate.span) != 0] = 0.0
    return np.concatenate(([0.0], np.cumsum(step)))

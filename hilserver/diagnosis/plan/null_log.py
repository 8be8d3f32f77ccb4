"""What the sensors would show of a manoeuvre if the model were right: a log without an effect."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.plan.manoeuvre import Manoeuvre
from hilserver.diagnosis.progress import Report
from hilserver.diagnosis.replay.drive_stage import DriveStage
from hilserver.diagnosis.replay.encoders import as_turned, driven
from hilserver.diagnosis.replay.pose_stage import PoseStage
from hilserver.diagnosis.thresholds import BLOCK_S
from hilserver.measured.channels import (
    DUTIES,
    GYRO,
    POSITION,
    SETPOINTS,
    SPEEDS,
    VOLTAGE,
    YAW,
)
from hilserver.measured.data import Channel, LogSource, MeasuredLog, Span
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.units import NOMINAL_V

GROUPS: Final = {
    "speed": SPEEDS,
    "duty": DUTIES,
    "position": POSITION,
    "yaw": (YAW,),
    "gyro": (GYRO,),
    "voltage": (VOLTAGE,),
}
"""Short names of the channels."""
ALL: Final = tuple(name for names in GROUPS.values() for name in names)
WHITE: Final = {
    **dict.fromkeys(SPEEDS, 0.12),
    **dict.fromkeys(DUTIES, 0.15),
    **dict.fromkeys(POSITION, 0.01),
    GYRO: 0.006,
    VOLTAGE: 0.02,
}
"""Standard deviations of the white noise of the reference logs."""
CORRELATED: Final = {**dict.fromkeys(POSITION, (0.05, 0.6)), YAW: (0.015, 2.0)}
"""Standard deviation and correlation time [s] of their Ornstein-Uhlenbeck noise."""
SATELLITES_HZ: Final = 5.0
SATELLITES_WHITE: Final = 0.1  # white share of the error of a position by satellites
SATELLITES_TAU_S: Final = 60.0  # its correlation time
JITTER_S: Final = 0.002
"""Of a row's time: rows that always fall on the same tick of a period hold less information."""
SAG_V_PER_S: Final = 0.001
AT_ONCE_S: Final = 1e6


@dataclass(frozen=True)
class PlannedRecording:
    """How the experiment will be recorded."""

    channels: tuple[str, ...] = ALL  # measured signals, besides the set-points
    rate_hz: float = 50.0  # rows per second
    navigation_hz: float = 20.0  # samples of the navigation per second
    # standard deviation of a position by satellites; None: that of the reference logs
    satellites_m: float | None = None


@dataclass(frozen=True)
class Studio:
    """What stays the same for every manoeuvre that is examined."""

    robot: RobotParameters
    seed: int
    jobs: int
    report: Report

    def null_log(
        self, spans: Sequence[Manoeuvre], recording: PlannedRecording
    ) -> tuple[MeasuredLog, np.random.Generator]:
        """Return the log of manoeuvres, and the generator that produced its noise."""
        rng = np.random.default_rng(self.seed)
        return null_log(spans, self.robot, recording, rng), rng


def null_log(
    spans: Sequence[Manoeuvre],
    robot: RobotParameters,
    recording: PlannedRecording,
    rng: np.random.Generator | None,
    terms: Mapping[str, float] | None = None,
) -> MeasuredLog:
    """Replay manoeuvres and add the noise of the reference logs.

    Parameters
    ----------
    spans : sequence of Manoeuvre
        Each becomes a span of its own that begins at rest at the origin.
    rng : Generator or None
        None: no noise.
    terms : mapping of str to float, optional
        Deviations of the robot from its model; a null log has none.
    """
    rate_hz, jitter = recording.rate_hz, np.random.default_rng(0)
    rows = [_stamps(m.duration_s, rate_hz, robot.period_s, jitter) for m in spans]
    tags = [
        _stamps(m.duration_s, recording.navigation_hz, robot.period_s, jitter)
        for m in spans
    ]
    begin = np.concatenate([[0.0], np.cumsum([m.duration_s + 1.0 for m in spans])])
    channels = _commands(spans, begin)
    for name in (*SPEEDS, *DUTIES, *POSITION, YAW, GYRO, VOLTAGE):
        channels[name] = _empty(tags if name in (*POSITION, YAW) else rows, begin)
    log = MeasuredLog(
        (LogSource("planned", ""),),
        channels,
        tuple(
            Span(i, None, float(begin[i]), float(begin[i] + m.duration_s))
            for i, m in enumerate(spans)
        ),
    )
    log = _with_truth(log, robot, dict(terms or {}))
    noisy = {}
    for name in recording.channels:
        c = log[name]
        values = c.values
        if rng is not None:
            values = values + _noise(name, c, rng, recording.satellites_m)
        noisy[name] = c.with_values(values)
    kept = {name: c for name, c in log.channels.items() if name in SETPOINTS}
    lasts = recording.satellites_m is not None
    return MeasuredLog(
        log.sources, {**kept, **noisy}, log.spans, pose_errors_last=lasts
    )


def _stamps(
    duration_s: float, rate_hz: float, period_s: float, rng: np.random.Generator
) -> Array:
    nominal = np.arange(0.0, duration_s, 1.0 / rate_hz)
    most = 0.2 / rate_hz
    moved = nominal + np.clip(JITTER_S * rng.standard_normal(len(nominal)), -most, most)
    last = np.floor(duration_s / period_s - 1e-6)
    ticks = np.unique(np.clip(np.rint(moved / period_s), 0, last))
    return np.asarray(ticks * period_s)


def _empty(stamps: Sequence[Array], begin: Array) -> Channel:
    t = np.concatenate([b + s for b, s in zip(begin, stamps, strict=False)])
    span = np.repeat(np.arange(len(stamps)), [len(s) for s in stamps])
    return Channel(t, np.zeros(len(t)), span)


def _commands(spans: Sequence[Manoeuvre], begin: Array) -> dict[str, Channel]:
    at = _empty([m.at_s for m in spans], begin)
    rpm = np.vstack([m.setpoints_rpm for m in spans])
    return {name: at.with_values(rpm[:, i].copy()) for i, name in enumerate(SETPOINTS)}


def _with_truth(
    log: MeasuredLog, robot: RobotParameters, terms: Mapping[str, float]
) -> MeasuredLog:
    """Fill in what the model shows: first the drive's own replay, then the pose from its speeds."""
    volts = log[VOLTAGE]
    log = log.with_channels(
        {VOLTAGE: volts.with_values(NOMINAL_V - SAG_V_PER_S * volts.t_s)}
    )
    drive = DriveStage(log, robot, block_s=BLOCK_S)
    log = log.with_channels(
        _filled(log, drive.stack.edges, drive.predict(terms), (*SPEEDS, *DUTIES))
    )
    pose = PoseStage(
        as_turned(log, robot, terms),
        robot,
        driven(drive, terms),
        block_s=BLOCK_S,
        longest_s=AT_ONCE_S,
    )
    at_origin = np.zeros((len(pose.segments), 3))
    names = (*POSITION, YAW, GYRO)
    return log.with_channels(
        _filled(log, pose.stack.edges, pose.predict(terms, at_origin), names)
    )


def _filled(
    log: MeasuredLog, edges: Mapping[str, slice], predicted: Array, names: Sequence[str]
) -> dict[str, Channel]:
    return {
        name: log[name].with_values(predicted[edges[name]].copy()) for name in names
    }


def _noise(
    name: str, channel: Channel, rng: np.random.Generator, satellites_m: float | None
) -> Array:
    fresh = rng.standard_normal(len(channel))
    if satellites_m is not None and name in POSITION:
        slow = _ornstein_uhlenbeck(channel.t_s, satellites_m, SATELLITES_TAU_S, rng)
        return np.asarray(SATELLITES_WHITE * satellites_m * fresh + slow)
    noise = WHITE.get(name, 0.0) * fresh
    if name in CORRELATED:
        noise += _ornstein_uhlenbeck(channel.t_s, *CORRELATED[name], rng)
    return np.asarray(noise)


def _ornstein_uhlenbeck(
    t_s: Array, sd: float, tau_s: float, rng: np.random.Generator
) -> Array:
    keep = np.exp(-np.diff(t_s, prepend=t_s[0] - 1e6) / tau_s)
    fresh = rng.standard_normal(len(t_s)) * np.sqrt(1.0 - keep**2)
    out, state = np.empty(len(t_s)), 0.0
    for k in range(len(t_s)):
        state = keep[k] * state + fresh[k]
        out[k] = state
    return sd * out


def path_of(
    spans: Sequence[Manoeuvre], robot: RobotParameters
) -> list[tuple[Array, Array, Array]]:
    """Return x [m], y [m] and yaw [rad] that the model drives in each span, from the origin."""
    log = null_log(spans, robot, PlannedRecording((*POSITION, YAW)), None)
    return [
        (log[POSITION[0]].of(i)[1], log[POSITION[1]].of(i)[1], log[YAW].of(i)[1])
        for i in range(len(spans))
    ]

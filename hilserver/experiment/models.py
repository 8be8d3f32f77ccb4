"""The kinematic and the mechatronic model on the wheel speeds of one recording."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from hilserver.arrays import Array, Indices
from hilserver.body.engine import BodyEngine
from hilserver.body.layout import BodyMotion
from hilserver.body.parameters import BodyParameters
from hilserver.body.slice import MIRROR
from hilserver.body.step import advance, body_axes, place_body
from hilserver.diagnosis.checks import Checked
from hilserver.diagnosis.decide import one_topic
from hilserver.diagnosis.replay.drive_stage import DriveStage
from hilserver.diagnosis.replay.encoders import driven
from hilserver.diagnosis.replay.pose_stage import PoseStage
from hilserver.diagnosis.replay.wheel_speeds import PAIRS, WheelSpeeds
from hilserver.diagnosis.thresholds import BLOCK_S, STILL_RPM
from hilserver.errors import LogError
from hilserver.identify.wheels import files
from hilserver.measured.channels import (
    DUTIES,
    DUTY_COMMANDS,
    GYRO,
    IMU_YAW,
    MODE,
    SETPOINTS,
    SPEEDS,
    TAG,
    TWIST,
)
from hilserver.measured.data import MeasuredLog, Span
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.units import RAD_S_PER_RPM

USED: Final = frozenset(
    (
        *SETPOINTS,
        *SPEEDS,
        *DUTIES,
        *DUTY_COMMANDS,
        *TWIST,
        *TAG,
        MODE,
        GYRO,
        IMU_YAW,
        "drive.enable",
    )
)
"""What an experiment needs of a recording; nothing else is checked."""
APART_S: Final = 1.0  # between spans whose clocks began anew
# samples of the tag from which the place of the start is taken
FEWEST_AT_REST: Final = 5


class LogSpan(NamedTuple):
    """One span of the log."""

    span: int
    t_s: Array  # shape (n,); rises evenly
    rows: Indices  # shape (n,); where it is in the dense arrays of the stage


@dataclass(frozen=True)
class Courses:
    """Both models from the same start, on the ticks of the plant, one span after the other."""

    log: MeasuredLog  # checked: without what its data checks refused
    notes: tuple[str, ...]  # what these checks say
    # False: the wheels are those of the configured drive, from set-points
    are_measured: bool
    t_s: Array  # shape (n,); from 0 on, and no span overlaps another
    span: Indices  # shape (n,)
    wheels_rpm: Array  # shape (n, 4)
    # shape (n, 4): x, y, yaw (not wrapped), turn rate
    kinematic: Array
    mechatronic: Array | None
    missing: str = ""  # why there is no mechatronic one, or where it ends

    def of(self, name: str) -> tuple[Array, Array, Indices]:
        """Return stamps, values and spans of a measured channel."""
        channel = self.log[name]
        shift_s = one_after_the_other(self.log.spans)
        return channel.t_s + shift_s[channel.span], channel.values, channel.span


def run_models(
    log: MeasuredLog, robot: RobotParameters, body: BodyParameters | str
) -> Courses:
    """Run both models.

    LogError if the recording does not show how the wheels turned.

    Parameters
    ----------
    body : BodyParameters or str
        The body, driven by speed, or the sentence that says why there is none.
    """
    checked = usable(log, robot)
    log = checked.log
    drive = None
    if DriveStage.replays(log):
        drive = driven(DriveStage(log, robot, block_s=BLOCK_S), {})
    stage = PoseStage(log, robot, drive, block_s=BLOCK_S, longest_s=None)
    wheels = all_four(WheelSpeeds(log, stage.segments, drive).shares)
    kinematic = stage.simulate({}, start_poses(stage))
    pieces = pieces_of(stage, one_after_the_other(log.spans))
    rows = np.concatenate([piece.rows for piece in pieces])

    mechatronic = None
    missing = ""
    if isinstance(body, str):
        missing = body
    else:
        paths = [follow(body, piece, wheels, kinematic) for piece in pieces]
        mechatronic = np.concatenate(paths)
        if np.isnan(mechatronic).any():
            missing = (
                "The mechatronic model ends where its numbers leave their valid range."
            )

    said = [finding.explanation for finding in checked.findings]
    lengths = [len(piece.rows) for piece in pieces]
    t_s = np.concatenate([piece.t_s for piece in pieces])
    span = np.repeat([piece.span for piece in pieces], lengths)
    return Courses(
        log=log,
        notes=(*log.notices, *said),
        are_measured=any(name in log for name in SPEEDS),
        t_s=t_s,
        span=span,
        wheels_rpm=wheels[rows],
        kinematic=kinematic[rows],
        mechatronic=mechatronic,
        missing=missing,
    )


def usable(log: MeasuredLog, robot: RobotParameters) -> Checked:
    """Return what an experiment needs of a log, checked; LogError if that is not enough."""
    checked = one_topic.checked(log.without(log.channels.keys() - USED), robot)
    has_setpoints = DriveStage.replays(checked.log)
    if not PoseStage.judges(checked.log, robot, driven=has_setpoints):
        raise LogError(
            f"{files(log)}: does not show both how the wheels of both sides turned and where"
            f" the robot was; record {SPEEDS[0]} ... or {SETPOINTS[0]} ... of all wheels, and"
            f" {', '.join(TAG)} or {GYRO}, or map their columns or topics"
        )
    return checked


def one_after_the_other(spans: Sequence[Span]) -> Array:
    """Return what to add to the stamps of each span: the first begins at 0, none overlaps."""
    shift_s = np.zeros(len(spans))
    usual_s = -spans[0].start_s
    end_s = -APART_S
    for i, span in enumerate(spans):
        if span.start_s + usual_s <= end_s:
            usual_s = end_s + APART_S - span.start_s
        shift_s[i] = usual_s
        end_s = span.end_s + usual_s
    return shift_s


def pieces_of(stage: PoseStage, shift_s: Array) -> list[LogSpan]:
    """Return where the spans are in the dense arrays of the stage.

    The stage begins before a span, for sensors that are late, and goes on a little after it.
    """
    found = []
    for i, span in enumerate(stage.segments.span.tolist()):
        t_s = stage.segments.times(i)
        first = lead_of(stage)
        end_s = stage.log.spans[span].end_s
        end = int(np.searchsorted(t_s, end_s, side="right"))
        rows = int(stage.segments.first[i]) + np.arange(first, end)
        found.append(LogSpan(span, t_s[first:end] + shift_s[span], rows))
    return found


def lead_of(stage: PoseStage) -> int:
    """Return how many rows the stage begins before a span."""
    return round(stage.segments.lead_s / stage.segments.period_s)


def start_poses(stage: PoseStage) -> Array:
    """Return the pose in which each span begins, shape (spans, 3).

    Where the robot rests at first it is the mean of what the tag shows until it moves: the noise of
    its position is larger than what the models differ by.
    """
    starts = stage.start_poses({})
    if not stage.log.has(*TAG):
        return starts
    turning = np.abs(stage.left) + np.abs(stage.right) > STILL_RPM
    for i, span in enumerate(stage.segments.span.tolist()):
        first = int(stage.segments.first[i]) + lead_of(stage)
        last = int(stage.segments.first[i + 1])
        rest = int(np.argmax(turning[first:last]))
        until_s = stage.segments.times(i)[lead_of(stage) + rest]

        shown = []
        for name in TAG:
            t_s, values = stage.log[name].of(span)
            shown.append(values[t_s < until_s])
        x, y, yaw = shown
        if min(len(x), len(y), len(yaw)) < FEWEST_AT_REST:
            continue
        heading = np.mean(np.exp(1j * yaw))
        starts[i] = x.mean(), y.mean(), np.angle(heading)
    return starts


def all_four(shares: Mapping[int, Array]) -> Array:
    """Return the speed of every wheel [rpm], shape (n, 4).

    An unmeasured wheel turns as the other one of its side, whose share is then that of both.
    """
    wheels = {}
    for front, rear in PAIRS:
        if front in shares and rear in shares:
            wheels[front] = shares[front]
            wheels[rear] = shares[rear]
        else:
            known = front if front in shares else rear
            wheels[front] = wheels[rear] = 0.5 * shares[known]
    return np.stack([wheels[w] for w in sorted(wheels)], axis=1)


def follow(
    body: BodyParameters, piece: LogSpan, wheels_rpm: Array, kinematic: Array
) -> Array:
    """Run the body with given wheel speeds; return x, y, yaw and turn rate, shape (n, 4).

    It begins at rest where the kinematic model does. NaN from where its numbers leave their valid
    range.
    """
    engine = BodyEngine(body)
    numbers = engine.initial.copy()
    b = BodyMotion.of(numbers)
    x, y, yaw, _ = kinematic[piece.rows[0]].tolist()
    place_body(engine.parameters, numbers, x, y, yaw)

    end_s = piece.t_s[-1] + body.slice_s
    at_s = np.arange(piece.t_s[0], end_s, body.slice_s)
    asked = np.empty((len(at_s), 4))
    for wheel, sign in enumerate(MIRROR):
        rpm = np.interp(at_s, piece.t_s, wheels_rpm[piece.rows, wheel])
        asked[:, wheel] = sign * RAD_S_PER_RPM * rpm

    path = np.full((len(at_s), 4), np.nan)
    for shown, command in zip(path, asked, strict=True):
        ahead, _, _ = body_axes(b.orientation)
        shown[:2] = b.position[:2]
        shown[2] = math.atan2(ahead[1], ahead[0])
        shown[3] = b.turning[2]
        b.asked[:] = command
        if not advance(engine.parameters, numbers, engine.addresses):
            break

    good = np.isfinite(path[:, 2])
    path[good, 2] = np.unwrap(path[good, 2])
    columns = [np.interp(piece.t_s, at_s, column) for column in path.T]
    return np.stack(columns, axis=1)

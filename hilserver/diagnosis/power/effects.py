"""A known effect in a recording: what was measured, plus the difference of two replays.

Noise, stamps and all that nobody has modelled stay as they were recorded. The two replays differ
in the effect alone; the second one begins each segment where the first one was, moved by what the
effect has added up to, so that an error of the heading carries on as it would in a drive.
"""

from collections.abc import Mapping
from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.regression.stages import stages_of
from hilserver.diagnosis.replay.model import Fitted
from hilserver.diagnosis.replay.pose_stage import PoseStage
from hilserver.diagnosis.replay.positions import paired
from hilserver.diagnosis.replay.stage import NO_POSES, Stage
from hilserver.measured.channels import DUTIES, YAW
from hilserver.measured.clock import Segments
from hilserver.measured.data import MeasuredLog
from hilserver.measured.resolution import step_of
from hilserver.plant.parameters import RobotParameters

HALF_TURN: Final = np.pi + 1e-6


def with_effect(
    log: MeasuredLog, robot: RobotParameters, effect: Fitted
) -> MeasuredLog:
    """Return a log of a robot that also has an effect.

    An effect of the drive moves the wheels and, through them, the robot.

    Parameters
    ----------
    robot : RobotParameters
        The machine of the log, see `measured.machine`.
    """
    log = paired(log)  # one coordinate alone is not judged, and would stay where it was
    terms = dict(effect.terms)
    before = after = stages_of(log, robot)
    if effect.candidate.stage == "drive":
        drive = before["drive"]
        moved = drive.predict(terms, NO_POSES) - drive.predict({}, NO_POSES)
        log = _added(log, drive, moved)
        after, terms = stages_of(log, robot, drive_terms=terms), {}

    first, second = before.get("pose"), after.get("pose")
    if not (isinstance(first, PoseStage) and isinstance(second, PoseStage)):
        return log
    poses = first.start_poses({})
    carried = _carried_on(first, second, terms, poses)
    shown = second.predict(terms, carried)
    return _added(log, first, first.difference(shown, first.predict({}, poses)))


def _carried_on(
    before: PoseStage, after: PoseStage, terms: Mapping[str, float], poses: Array
) -> Array:
    """Return initial poses with the effect, such that it adds up from segment to segment."""
    segments, out = before.segments, poses.copy()
    as_it_was, moved = before.simulate({}, poses), after.simulate(terms, poses)
    places, moved_places = (d[:, 0] + 1j * d[:, 1] for d in (as_it_was, moved))
    headings, moved_headings = as_it_was[:, 2], moved[:, 2]

    turn, shift = 0.0, 0j  # from the second replay to where the effect has brought it
    for i in range(1, len(segments)):
        if segments.span[i] != segments.span[i - 1]:
            turn, shift = 0.0, 0j
            continue
        # where the segment before ends, the effect has brought the robot so far
        end = _row(segments, i - 1, segments.start_s[i])
        off = moved_places[end] * np.exp(1j * turn) + shift - places[end]
        off_yaw = moved_headings[end] + turn - headings[end]

        begin = _row(segments, i, segments.start_s[i])
        turn = headings[begin] + off_yaw - moved_headings[begin]
        shift = places[begin] + off - moved_places[begin] * np.exp(1j * turn)
        start = complex(*poses[i, :2]) * np.exp(1j * turn) + shift
        out[i] = start.real, start.imag, poses[i, 2] + turn
    return out


def _row(segments: Segments, index: int, t_s: float) -> int:
    """Return the row of a segment that is nearest to a time."""
    since_s = t_s - segments.start_s[index] + segments.lead_s
    row = int(segments.first[index] + np.rint(since_s / segments.period_s))
    return min(row, int(segments.first[index + 1]) - 1)


def _added(log: MeasuredLog, stage: Stage, difference: Array) -> MeasuredLog:
    """Return a log with a difference added to the samples that a stage predicts."""
    stack, changed = stage.stack, {}
    for name, edge in stack.edges.items():
        channel = log[name]
        values = channel.values.copy()
        span = stage.segments.span[stack.segment[edge]]
        for own in np.unique(span):
            mine = span == own
            begin, end = np.searchsorted(channel.span, [own, own + 1])
            rows = np.searchsorted(channel.t_s[begin:end], stack.t_s[edge][mine])
            values[begin + rows] += difference[edge][mine]
        changed[name] = channel.with_values(_as_recorded(name, channel.values, values))
    return log.with_channels(changed)


def _as_recorded(name: str, before: Array, values: Array) -> Array:
    """Return changed values as the recorder would have written them: steps, limits, half turns."""
    step, origin = step_of(before)
    if step > 0.0:
        values = origin + step * np.rint((values - origin) / step)
    if name in DUTIES:
        most = float(abs(before).max(initial=0.0))
        values = np.clip(values, -most, most)
    if name == YAW and abs(before).max(initial=0.0) <= HALF_TURN:
        values = np.arctan2(np.sin(values), np.cos(values))
    return np.asarray(values)

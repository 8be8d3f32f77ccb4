"""Replay of the configured plant from three cut points, to find the block of the error.

From the set-points the whole chain is replayed, from the measured duty the process alone, from the
measured wheel speeds the kinematics alone. A residual that exceeds the sensors' noise from one cut
point, and not from the next, arises between the two.
"""

from collections.abc import Collection
from typing import Final

import numpy as np

from hilserver.arrays import Array, Mask
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.regression.stages import Prepared
from hilserver.diagnosis.replay.drive_stage import DriveStage
from hilserver.diagnosis.replay.model import Model
from hilserver.diagnosis.replay.pose_stage import PoseStage
from hilserver.diagnosis.schema.evidence import CutRow
from hilserver.measured.channels import DUTIES, SPEEDS
from hilserver.measured.names import signal_unit
from hilserver.plant.parameters import RobotParameters

CUTS: Final = ("setpoints", "duty", "speed")
POSE_STEPS: Final = 2
"""Fits of the free initial poses: from the set-points the pose drifts far away."""
DENSE_SHARE: Final = 0.5
"""Share of the closed loop's time constant: samples closer than this show the duty in between."""
# closed-loop time constants after which the duty changes slowly again
FALL: Final = 8.0
REST: Final = 7.0
"""Time constants of the process after which a duty that was not recorded no longer matters."""
FEWEST: Final = 20


def cuts(stages: Collection[Prepared]) -> tuple[CutRow, ...]:
    """Return the residual of every channel from every cut point that the log allows.

    Parameters
    ----------
    stages : collection of Prepared
        Drive, pose or both. The configured plant is replayed, whatever was found.
    """
    known = any(p.problem.stage.follows_setpoints for p in stages)
    rows = [row for p in stages for row in _from_all(p, setpoints=known)]
    return tuple(sorted(rows, key=lambda row: CUTS.index(row.cut)))


def _from_all(p: Prepared, *, setpoints: bool) -> list[CutRow]:
    """Return the residuals of one stage from every cut point.

    Parameters
    ----------
    setpoints : bool
        Whether the log holds those that the machine received.
    """
    stage, rows = p.problem.stage, []
    if isinstance(stage, DriveStage):
        whole = _rows("setpoints", p.problem, p.problem.residual(p.base.predicted))
        return whole + _process_only(stage, p.problem)
    if setpoints and isinstance(stage, PoseStage) and stage.drive is not None:
        chain = Problem(stage.as_simulated(), p.problem.noise, p.problem.weights)
        far = chain.point(Model(), chain.start_poses({}), pose_steps=POSE_STEPS)
        rows += _of_pose("setpoints", chain, far)
    if any(n in stage.log for n in SPEEDS):
        rows += _of_pose("speed", p.problem, p.base)
    return rows


def _of_pose(cut: str, problem: Problem, point: Point) -> list[CutRow]:
    """Return the residuals of the pose at a point, with free initial poses."""
    more = _added_by_start(problem, point.predicted, point.poses)
    return _rows(cut, problem, problem.residual(point.predicted), more=more)


def remarks(stages: Collection[Prepared]) -> tuple[str, ...]:
    """Return what a reader of the cuts must know."""
    for problem in (p.problem for p in stages):
        stack, robot = problem.stack, problem.stage.robot
        duties = [stack.t_s[stack.edges[n]] for n in DUTIES if n in stack.edges]
        if any(
            np.median(np.diff(t)) > DENSE_SHARE * _closed_s(robot)
            for t in duties
            if len(t) > 1
        ):
            return (
                "The duty was recorded at too low a rate to be known between samples after a"
                " step: in the replay from the duty, a wheel speed counts only where the"
                f" set-points had been constant for {REST * robot.process.t1_s:.2f} s. A wrong"
                " motor time constant shows only in the whole chain.",
            )
    return ()


def _rows(
    cut: str,
    problem: Problem,
    residual: Array,
    *,
    more: Array | None = None,
    only: Mask | None = None,
) -> list[CutRow]:
    """Compare residuals with the sensors' noise.

    Parameters
    ----------
    more : ndarray, shape (n,), optional
        Further variance of every sample: what the noise of the cut's own sensor adds or, negative,
        what the fit of the initial poses removes.
    only : ndarray of bool, shape (n,), optional
        Samples that can be judged.
    """
    rows = []
    for name in problem.stack.channels:
        edge = problem.stack.edges[name]
        weights = problem.weights[edge]
        used = weights > 0.0
        if only is not None:
            used &= only[edge]
        if used.sum() < FEWEST:
            continue
        rms = float(np.sqrt(np.mean((weights * residual[edge] ** 2)[used])))
        variance = problem.noise[name].sd ** 2
        if more is not None:
            variance += float(np.mean(more[edge][used]))
        expected = float(np.sqrt(variance)) if variance > 0.0 else None
        rows.append(CutRow(cut, name, signal_unit(name), rms, expected))
    return rows


def _added_by_start(problem: Problem, predicted: Array, poses: Array) -> Array | None:
    """Return the variance that each sample loses to the fit of its initial pose, negative.

    From generalised least squares: the diagonal of ``X (X' C^-1 X)^-1 X'``.
    """
    columns = problem.nuisance(predicted, poses)
    if columns is None:
        return None
    white, segment = problem.whiten(columns), problem.stack.segment
    out = np.zeros(len(columns))
    for i in range(len(problem.stage.segments)):
        rows = np.flatnonzero(segment == i)
        spread = np.linalg.pinv(white[rows].T @ white[rows], hermitian=True)
        out[rows] = -np.einsum("ij,jk,ik->i", columns[rows], spread, columns[rows])
    return out


def _process_only(stage: DriveStage, problem: Problem) -> list[CutRow]:
    """Return the residuals of the wheel speeds under the measured duty.

    Between its samples the duty is the simulated one plus the interpolated difference. After a step
    of a set-point it falls within milliseconds, and differently with another controller. If the log
    does not show that, speeds count only after the process has forgotten it.
    """
    stack = problem.stack
    _, _, duty = stage.simulate({})
    noisy, rng = duty.copy(), np.random.default_rng(0)
    judged = np.zeros(len(stack), dtype=bool)
    for w in range(4):
        if not {SPEEDS[w], DUTIES[w]} <= set(stack.channels):
            continue
        edge, speed = stack.edges[DUTIES[w]], stack.edges[SPEEDS[w]]
        held = np.floor(stack.at[edge] + 1e-6)
        difference = stack.values[edge] - duty[held.astype(np.int64), w]
        noise = problem.noise[DUTIES[w]].sd * rng.standard_normal(len(held))
        duty[:, w] += _between(stage, edge, held, difference)
        noisy[:, w] = duty[:, w] + _between(stage, edge, held, noise)
        since = stage.since(_unseen(stage, w, held))
        rested = since >= REST * stage.robot.process.t1_s
        judged[speed] = rested[stack.at[speed].astype(np.int64)]
    seen = stage.sampled(stage.process_only(duty), duty)
    shaken = stage.sampled(stage.process_only(noisy), duty)
    residual = problem.residual(seen)
    return _rows("duty", problem, residual, more=(shaken - seen) ** 2, only=judged)


def _unseen(stage: DriveStage, wheel: int, held: Array) -> Mask:
    """Return the ticks at which a duty falls after a step while its samples are too far apart.

    In a ramp of many steps every sample shows the same moment of the fall, so there every tick
    without a sample counts as unseen.
    """
    segments = stage.segments
    segment = stage.stack.segment[stage.stack.edges[DUTIES[wheel]]]
    gap_s = np.full(segments.ticks, np.inf)
    for i in range(len(segments)):
        at = held[segment == i].astype(np.int64)
        if len(at) > 1:
            apart = np.diff(at)
            gap_s[at[0] : at[-1]] = np.repeat(apart, apart) * segments.period_s
    closed_s = _closed_s(stage.robot)
    fall_s, stepped = FALL * closed_s, stage.stepped(wheel)
    since = stage.since(stepped)
    again = stepped & (np.concatenate([[np.inf], since[:-1]]) < fall_s)
    ramp = (stage.since(again) < fall_s) & (gap_s > 1.5 * segments.period_s)
    return ramp | ((since < fall_s) & (gap_s > DENSE_SHARE * closed_s))


def _closed_s(robot: RobotParameters) -> float:
    """Return the time constant of the closed loop, with which a duty falls after a step."""
    process, controller = robot.process, robot.controller
    return process.t1_s / (1.0 + controller.k_p * process.gain)


def _between(stage: DriveStage, edge: slice, at: Array, values: Array) -> Array:
    """Return samples of one channel, interpolated at every tick, constant beyond the outer ones."""
    out, first = np.zeros(stage.segments.ticks), stage.segments.first
    segment = stage.stack.segment[edge]
    for i in range(len(stage.segments)):
        rows = segment == i
        if rows.any():
            out[first[i] : first[i + 1]] = np.interp(
                np.arange(first[i], first[i + 1]), at[rows], values[rows]
            )
    return out

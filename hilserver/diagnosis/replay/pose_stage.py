"""Replay from the measured wheel speeds: pose and turn rate of the kinematics alone (cut C)."""

from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import ClassVar, Final

import numpy as np

from hilserver.arrays import Array, Indices
from hilserver.diagnosis.catalogue.candidate import Candidate
from hilserver.diagnosis.catalogue.library import (
    encoders,
    pose_candidates,
    roller_candidates,
    side_encoders,
)
from hilserver.diagnosis.catalogue.traits import Need
from hilserver.diagnosis.catalogue.vocabulary import LATENCIES
from hilserver.diagnosis.checks.support import row_period_s
from hilserver.diagnosis.replay.encoders import Driven, driven
from hilserver.diagnosis.replay.kernels import sample
from hilserver.diagnosis.replay.model import robot_with
from hilserver.diagnosis.replay.pose_kernels import run_pose, sample_tag
from hilserver.diagnosis.replay.positions import begins_anew, driven_place, paired
from hilserver.diagnosis.replay.stack import Stack, make_stack
from hilserver.diagnosis.replay.stage import Stage
from hilserver.diagnosis.replay.wheel_speeds import WheelSpeeds, angles_at_starts
from hilserver.measured.channels import DUTIES, GYRO, POSITION, SPEEDS, TAG, YAW
from hilserver.measured.clock import cut
from hilserver.measured.data import MeasuredLog
from hilserver.measured.thresholds import LONGEST_SEGMENT_S
from hilserver.plant.layout import Outputs, Parameters
from hilserver.plant.packing import initial_state, pack
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.units import RAD_S_PER_RPM

LEAD_S: Final = 0.7
"""Simulated before a segment begins: what the navigation shows late happened then."""
STRIDES: Final = (2, 10)
"""Plant slices per step of the pose: 2 ms suffice, as its arc is exact for a constant velocity; ...

... except for samples that the plant itself took at its ticks.
"""
SLOW_ROWS_S: Final = 0.04
"""... and 10 ms if only wheel speeds in slower rows were recorded."""
RUNS_KEPT: Final = 2  # that of a model, and of a step tried from it
_SENSORS: Final = Parameters.where("seed").start
"""The parameters from here on do not change how the robot moves."""
HEADING, TURN = "pose.yaw_rad", "velocity.angular_rad_s"
FORWARD, LATERAL = "velocity.linear_m_s", "velocity.lateral_m_s"


class PoseStage(Stage):
    """The kinematics of one log: the motion that results from the measured wheel speeds.

    Parameters
    ----------
    jobs : int
        Threads that share the segments of a run; they do not change any digit.
    slices : int, optional
        Plant slices per step of the pose; without it the log decides.

    Attributes
    ----------
    segments : Segments
        Spans cut to at most `LONGEST_SEGMENT_S`; each has a free initial pose.
    stack : Stack
        Measured position, yaw and turn rate.
    left, right : ndarray, shape (ticks,)
        Sums of the speeds of both wheels of a side [rpm].
    apart : ndarray, shape (2, ticks) or (2, 0)
        Front minus rear wheel of both sides [rpm], which moves a mecanum robot to the side.
    begins_anew : bool
        Place and heading begin anew with every segment: their frame is not known.
    encoders : mapping of int to ndarray, shape (ticks,)
        By wheel: its share in these, if only the pose can judge its encoder.
    """

    name = "pose"
    block = "kinematics"
    memoryless = False
    follows_setpoints = False
    needs = (
        Need.POSITION,
        Need.PLACE,
        Need.STEADY,
        Need.YAW,
        Need.GYRO,
        Need.STAMPS,
    )
    quantities: ClassVar = {"gyro_z_rad_s": (GYRO,)}

    def __init__(
        self,
        log: MeasuredLog,
        robot: RobotParameters,
        drive: Driven | None,
        *,
        block_s: float,
        longest_s: float | None = LONGEST_SEGMENT_S,
        jobs: int = 1,
        slices: int | None = None,
    ) -> None:
        log = paired(log)
        self.log, self.robot = log, robot
        self.drive = None if drive is None else drive[0]
        self._driven, self._block_s = drive, block_s
        slices = slices or stride(log, driven=drive is not None)
        self.period_s = slices * robot.period_s
        self.begins_anew = begins_anew(log)
        self.segments = cut(log, self.period_s, longest_s, LEAD_S)
        wheels = WheelSpeeds(log, self.segments, drive)
        self.left, self.right = wheels.sides()
        self.apart = wheels.apart() if robot.is_mecanum else np.empty((2, 0))
        self.encoders: dict[int, Array] = {}
        if drive is None or not any(
            n in log for n in DUTIES
        ):  # duties show it far better
            self.encoders = {
                w: own for w, own in wheels.shares.items() if SPEEDS[w] in log
            }
        self.angle_0 = angles_at_starts(self.left, self.segments)
        names = [n for n in (*TAG, GYRO) if n in log]
        usable = np.array(
            [self._is_driven(int(s)) for s in self.segments.span], dtype=bool
        )
        self.stack = make_stack(
            log,
            names,
            self.segments,
            block_s=block_s,
            skip_s=self._settling_s() if log.on_ticks else 0.0,
            usable=usable,
        )
        self.has_position = log.has(*POSITION)
        self.has_yaw = YAW in log
        self.free_pose = self.has_position or self.has_yaw
        self._state = initial_state(robot)
        self._encoder_gain = pack(robot).encoder_gain
        self._pool = ThreadPoolExecutor(jobs) if jobs > 1 else None
        self._jobs, self._every = jobs, np.arange(len(self.segments))
        self._judge_samples()

    def _settling_s(self) -> Array:
        """Return how long in each segment the wheels depend on how they were interpolated.

        The initial state of the wheels' loops is not in the recording. With noise that does not
        matter, but a simulation without noise shows it.
        """
        wait_s = np.zeros(len(self.segments))
        if self.drive is not None:
            begins, ends = self.drive.segments, self.drive.settled_s
            for i, span in enumerate(self.segments.span):
                own = int(np.flatnonzero(begins.span == span)[0])
                wait_s[i] = max(float(ends[own] - self.segments.start_s[i]), 0.0)
        return wait_s

    def _is_driven(self, span: int) -> bool:
        """Return whether it is known how the wheels turned in a span."""
        if self.drive is not None and self.drive.has_setpoints(span):
            return True
        log = self.log
        return tell_motion(
            self.robot, lambda n: n in log and len(log[n].of(span)[0]) > 0
        )

    def on(self, stack: Stack) -> "PoseStage":
        """Return the stage with some of its samples."""
        other = super().on(stack)
        other._judge_samples()
        return other

    def uncut(self, slices: int | None = None) -> "PoseStage":
        """Return the stage with whole spans as its segments."""
        return PoseStage(
            self.log,
            self.robot,
            self._driven,
            block_s=self._block_s,
            longest_s=None,
            slices=slices,
        )

    def as_simulated(self) -> "PoseStage":
        """Return the stage with wheels that turn as the configured drive does from set-points."""
        assert self.drive is not None
        wheels = driven(self.drive, {})
        return PoseStage(
            self.log.without(SPEEDS), self.robot, wheels, block_s=self._block_s
        )

    def candidates(self) -> list[Candidate]:
        """Return the causes of kinematics, navigation and gyro, and of encoders."""
        found = pose_candidates(driven_place(self.log))
        if self.robot.is_mecanum:
            return found + roller_candidates() + encoders(self.encoders)
        return found + side_encoders(self.encoders)

    @property
    def lateral_m_s(self) -> Array:
        """Speed to the left [m/s] that nominal wheels make, shape (ticks,); none with tyres."""
        if not self.apart.size:
            return np.zeros(self.segments.ticks)
        rim_m_s_per_rpm = RAD_S_PER_RPM * self.robot.wheel_radius_m
        return np.asarray(-0.25 * rim_m_s_per_rpm * self.apart.sum(axis=0))

    @staticmethod
    def judges(log: MeasuredLog, robot: RobotParameters, *, driven: bool) -> bool:
        """Return whether the log has what this stage needs.

        Parameters
        ----------
        driven : bool
            Whether the drive's stage replays wheels whose speed is not measured.
        """
        moved = driven or tell_motion(robot, lambda name: name in log)
        return moved and (log.has(*POSITION) or YAW in log or GYRO in log)

    def simulate(self, terms: Mapping[str, float], poses: Array) -> Array:
        """Return x, y, yaw (not wrapped) and turn rate at every tick, shape (ticks, 4)."""
        inner = {k: v for k, v in terms.items() if not k.startswith("shift.")}
        return self._run(self._pack(inner), poses, self._every)

    def _pack(self, terms: Mapping[str, float]) -> Parameters:
        p = pack(robot_with(self.robot, terms))
        p.dt = self.period_s
        return p

    def _run(
        self, p: Parameters, poses: Array, which: Indices, *, keep: bool = False
    ) -> Array:
        """Run some segments, or return their kept run if only sensors have changed since."""
        key = (p.numbers[:_SENSORS].tobytes(), poses.tobytes(), which.tobytes())
        for known, dense in list(self._kept):
            if known == key:
                return dense
        dense = np.empty((self.segments.ticks, 4))
        wheels = self._turned(p)

        def run(share: Indices) -> None:
            x, y, first = self._state.copy(), Outputs.zeros(), self.segments.first
            run_pose(p, x, share, first, *wheels, poses, self.angle_0, y, dense)

        if self._pool is None:
            run(which)
        else:
            list(self._pool.map(run, np.array_split(which, self._jobs)))
        if keep:
            self._kept.append((key, dense))
        return dense

    def _turned(self, p: Parameters) -> tuple[Array, Array, Array]:
        """Return sums and differences of the true speeds of the wheels, not of their encoders."""
        sides, apart = [self.left, self.right], self.apart
        for wheel, share in self.encoders.items():
            turns = self._encoder_gain[wheel] / p.encoder_gain[wheel]
            if turns != 1.0:
                more = (turns - 1.0) * share
                sides[wheel // 2] = sides[wheel // 2] + more
                if apart.size:
                    apart = apart.copy()
                    apart[wheel // 2] += -more if wheel % 2 else more
        return sides[0], sides[1], apart

    def predict(
        self, terms: Mapping[str, float], poses: Array, *, keep: bool = False
    ) -> Array:
        """Return what the stack's samples would be; yaw follows the measured turns.

        With `keep` the run is remembered: predictions that differ from it only in sensors are then
        cheap.
        """
        inner = {k: v for k, v in terms.items() if not k.startswith("shift.")}
        p = self._pack(inner)
        return self.shown(self._run(p, poses, self._used, keep=keep), p, terms)

    def shown(self, dense: Array, p: Parameters, terms: Mapping[str, float]) -> Array:
        """Return what tag and gyro show of a dense pose."""
        stack, out = self.stack, np.empty(len(self.stack))
        rate = 1.0 / self.period_s
        nav = self.robot.nav
        shift = terms.get("shift.nav", 0.0)
        late_s = {signal: terms.get(term, 0.0) for signal, term in LATENCIES.items()}
        position_s = nav.latency_s + late_s[POSITION[0]] + shift
        yaw_s = nav.yaw_latency_s + late_s[YAW] + shift
        if self.free_pose:
            tag = np.empty((len(self._tag_at), 3))
            sample_tag(
                p.copy(),
                self._state.copy(),
                dense,
                self._tag_low,
                self._tag_high,
                self._tag_at - position_s * rate,
                self._tag_at - yaw_s * rate,
                tag,
            )
            for column, name in enumerate(TAG):
                if name in stack.edges:
                    out[stack.edges[name]] = tag[self._tag_index[name], column]
        if GYRO in stack.edges:
            edge = stack.edges[GYRO]
            at = stack.at[edge] - late_s[GYRO] * rate
            sample(dense, 3, stack.low[edge], stack.high[edge], at, out[edge])
            out[edge] *= p.gyro_gain
            out[edge] += p.gyro_bias
        return out

    def signals(self, terms: Mapping[str, float], poses: Array) -> Mapping[str, Array]:
        """Return place, heading and velocity of the body at every tick."""
        dense = self.simulate(terms, poses)
        yaw = np.arctan2(np.sin(dense[:, 2]), np.cos(dense[:, 2]))
        return {
            POSITION[0]: dense[:, 0],
            POSITION[1]: dense[:, 1],
            YAW: yaw,
            HEADING: yaw,
            FORWARD: self.forward_m_s(),
            LATERAL: self.lateral_m_s,
            TURN: dense[:, 3],
        }

    def forward_m_s(self) -> Array:
        """Return the forward speed that the wheels ask for, at every tick."""
        rim_m_s_per_rpm = RAD_S_PER_RPM * self.robot.wheel_radius_m
        return 0.25 * rim_m_s_per_rpm * (self.left - self.right)

    def difference(self, samples: Array, others: Array) -> Array:
        """Return samples minus others; yaw the shorter way round."""
        out = samples - others
        if self.has_yaw:
            edge = self.stack.edges[YAW]
            out[edge] -= 2.0 * np.pi * np.rint(out[edge] / (2.0 * np.pi))
        return out

    def nuisance(self, predicted: Array, poses: Array) -> Array | None:
        """Return the prediction's derivative by the initial pose of its segment, shape (n, 3)."""
        if not self.free_pose:
            return None
        columns = np.zeros((len(self.stack), 3))
        stack = self.stack
        if self.has_position:
            x, y = (stack.edges[n] for n in POSITION)
            columns[x, 0] = 1.0
            columns[y, 1] = 1.0
            px, py = predicted[x], predicted[y]
            if len(px) == len(py):
                columns[x, 2] = -(py - poses[stack.segment[x], 1])
                columns[y, 2] = px - poses[stack.segment[y], 0]
        if self.has_yaw:
            columns[stack.edges[YAW], 2] = 1.0
        return columns

    def start_poses(self, terms: Mapping[str, float]) -> Array:
        """Return a first guess of the initial poses, shape (m, 3)."""
        poses = np.zeros((len(self.segments), 3))
        if not self.free_pose:
            return poses
        predicted = self.predict(terms, poses)
        for i in range(len(self.segments)):
            poses[i] = self._place(i, predicted)
        return poses

    def _place(self, i: int, predicted: Array) -> Array:
        stack = self.stack
        mine = {n: stack.edges[n].start + np.flatnonzero(stack.segment[stack.edges[n]] == i)
                for n in TAG if n in stack.edges}  # fmt: skip
        yaw = 0.0
        if self.has_yaw and len(mine[YAW]):
            d = stack.values[mine[YAW]][:25] - predicted[mine[YAW]][:25]
            yaw = float(np.angle(np.mean(np.exp(1j * d))))
        if not self.has_position or not len(mine[POSITION[0]]):
            return np.array([0.0, 0.0, yaw])
        z = stack.values[mine[POSITION[0]]] + 1j * stack.values[mine[POSITION[1]]]
        w = predicted[mine[POSITION[0]]] + 1j * predicted[mine[POSITION[1]]]
        if not self.has_yaw:
            n = min(len(z), max(40, len(z) // 3))
            yaw = float(np.angle(np.vdot(w[:n] - w[:n].mean(), z[:n] - z[:n].mean())))
        n = min(len(z), 40)
        offset = z[:n] - w[:n] * np.exp(1j * yaw)
        return np.array([np.median(offset.real), np.median(offset.imag), yaw])

    def _judge_samples(self) -> None:
        """Find what the samples need: their segments, and distinct stamps of the tag's channels."""
        stack = self.stack
        self._used = np.unique(stack.segment)
        self._kept: deque[tuple[tuple[bytes, ...], Array]] = deque(maxlen=RUNS_KEPT)
        names = [n for n in TAG if n in stack.edges]
        if not names:
            return
        at = np.concatenate([stack.at[stack.edges[n]] for n in names])
        unique, first, inverse = np.unique(at, return_index=True, return_inverse=True)
        low = np.concatenate([stack.low[stack.edges[n]] for n in names])
        high = np.concatenate([stack.high[stack.edges[n]] for n in names])
        self._tag_at, self._tag_low, self._tag_high = unique, low[first], high[first]
        self._tag_index: dict[str, Indices] = {}
        begin = 0
        for name in names:
            end = begin + stack.edges[name].stop - stack.edges[name].start
            self._tag_index[name] = inverse[begin:end]
            begin = end


def tell_motion(robot: RobotParameters, is_there: Callable[[str], bool]) -> bool:
    """Return whether the known speeds suffice: one per side, for mecanum wheels all of them.

    A side without a speed would stand still.
    """
    enough = all if robot.is_mecanum else any
    return all(enough(map(is_there, side)) for side in (SPEEDS[:2], SPEEDS[2:]))


def stride(log: MeasuredLog, *, driven: bool) -> int:
    """Return how many plant slices a step of the pose takes."""
    if log.on_ticks:
        return 1
    if driven:
        return STRIDES[0]
    periods = [row_period_s(log[n]) for n in SPEEDS if n in log]
    return STRIDES[bool(periods) and min(periods) > SLOW_ROWS_S]

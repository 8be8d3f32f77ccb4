"""Replay from the set-points: wheel speeds and duties of the whole chain (cut points A and B)."""

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Final

import numpy as np

from hilserver.arrays import Array, Indices, Mask
from hilserver.diagnosis.catalogue.candidate import Candidate
from hilserver.diagnosis.catalogue.library import drive_candidates
from hilserver.diagnosis.catalogue.traits import Need
from hilserver.diagnosis.catalogue.vocabulary import SPEED_SCALES, SPEED_STEP
from hilserver.diagnosis.replay.battery import voltage
from hilserver.diagnosis.replay.control_clock import periods_shown
from hilserver.diagnosis.replay.kernels import (
    place_inputs,
    run_drive,
    run_process,
    sample,
)
from hilserver.diagnosis.replay.missing_rows import without_unknown_commands
from hilserver.diagnosis.replay.model import robot_with
from hilserver.diagnosis.replay.stack import Stack, make_stack
from hilserver.diagnosis.replay.stage import NO_POSES, Stage
from hilserver.measured.channels import (
    DUTIES,
    DUTY_COMMANDS,
    SETPOINTS,
    SPEEDS,
    TWIST,
    VOLTAGE,
)
from hilserver.measured.clock import cut
from hilserver.measured.data import MeasuredLog
from hilserver.measured.resolution import step_of
from hilserver.plant.layout import MODE_TWIST, RING, WHEELS, Inputs, Outputs, State
from hilserver.plant.packing import initial_state, pack
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.units import NOMINAL_V, RAD_S_PER_RPM


def _place(name: str) -> int:
    return int(Inputs.where(name).start)


INPUTS: Final[Mapping[str, int]] = {
    **{name: _place("setpoint") + i for i, name in enumerate(SETPOINTS)},
    **{name: _place("duty") + i for i, name in enumerate(DUTY_COMMANDS)},
    "twist.linear_m_s": _place("twist_linear"),
    "twist.angular_rad_s": _place("twist_angular"),
    "twist.lateral_m_s": _place("twist_lateral"),
    "control.mode": _place("mode"),
    "drive.enable": _place("enable"),
    "internal.command": _place("command"),
}
SCALES: Final = frozenset(SPEED_SCALES.values())
FULL_DUTY_PCT: Final = 100.0
SETTLING_S: Final = 1.0
MOVING_RPM: Final = 1.0
ON_TIME: Final = 1e-3
"""Share of a tick by which a stamp may miss it: seconds since 1970 are rounded to 2.4e-7 s."""
TICK_PARTS: Final = (1, 2, 5, 10)
"""Into which a tick is divided for a controller whose period is no whole number of ticks."""


def parts_of_tick(robot: RobotParameters) -> int:
    """Return into how many parts a tick is divided, so that the controller runs at ends of some.

    The most parts come close for every period.
    """
    tick_s, terms = robot.period_s, robot.terms
    ticks = (terms.get("control_period") or tick_s) / tick_s
    delay = (terms.get("actuation_delay") or 0.0) / tick_s
    able = [n for n in TICK_PARTS if n == 1 or n * delay < RING - 1]
    return next(
        (n for n in able if abs(n * ticks - round(n * ticks)) < ON_TIME), able[-1]
    )


class DriveStage(Stage):
    """The drive of one log: speed and duty according to the base plant and its variations.

    Attributes
    ----------
    segments : Segments
        The spans of the log, uncut: the drive's state continues.
    stack : Stack
        Measured speeds and duties.
    settled_s : ndarray, shape (segments,)
        Time from which the unknown start of the loops no longer matters.
    """

    name = "drive"
    block = "drive"
    memoryless = True
    follows_setpoints = True
    needs = (Need.SPEED, Need.DUTY, Need.VOLTAGE, Need.STAMPS)
    quantities: ClassVar = {"speed_rpm": SPEEDS, "duty_pct": DUTIES}

    def __init__(
        self, log: MeasuredLog, robot: RobotParameters, *, block_s: float
    ) -> None:
        self.log, self.robot, self._rest = log, robot, initial_state(robot)
        self.segments = cut(log, robot.period_s, None)
        names = [n for n in (*SPEEDS, *DUTIES) if n in log]
        skips_s = self._unknown_s()
        self.settled_s = self.segments.start_s + np.minimum(skips_s, SETTLING_S)
        known = without_unknown_commands(log, self._commanded, names)
        self.stack = make_stack(
            known, names, self.segments, block_s=block_s, skip_s=skips_s
        )
        self._rounded = any(step_of(log[n].values)[0] > 0.0 for n in SPEEDS if n in log)
        self._inputs, self._row = self._latched()
        self._speed_0 = self._start()
        self._spare: list[tuple[Array, Array]] = []  # one per thread, for its run
        self._last: tuple[Stack, dict[str, float], Array] | None = None
        self._volts = np.full(self.segments.ticks, NOMINAL_V)
        if log.on_ticks:
            self._inputs, self._row = self._placed()
        if VOLTAGE in log:
            _, _, duty = self.simulate({})
            self._volts = voltage(log, self.segments, np.abs(duty).sum(axis=1))

    @staticmethod
    def judges(log: MeasuredLog) -> bool:
        """Return whether the log has what this stage needs."""
        return DriveStage.replays(log) and any(n in log for n in (*SPEEDS, *DUTIES))

    @staticmethod
    def replays(log: MeasuredLog) -> bool:
        """Return whether the log has what moves the wheels, even if nothing shows how they turn."""
        return log.has(*SETPOINTS) or log.has(*TWIST)

    def simulate(self, terms: Mapping[str, float]) -> tuple[Array, Array, Array]:
        """Return true speed, shown speed and duty at every tick, each of shape (ticks, 4)."""
        speed, seen, duty = (np.empty((self.segments.ticks, 4)) for _ in range(3))
        self._run(terms, speed, seen, duty)
        return speed, seen, duty

    def _run(
        self, terms: Mapping[str, float], speed: Array, seen: Array, duty: Array
    ) -> None:
        """Write what `simulate` returns; with one array for both speeds, the shown one remains."""
        robot = robot_with(
            self.robot, {k: v for k, v in terms.items() if "shift." not in k}
        )
        phase = terms.get("shift.control_phase", 0.0)
        parts = parts_of_tick(robot)

        if parts == 1:
            self._replay(robot, 1, phase, speed, seen, duty)
            return

        # a controller that runs between the ticks sees and acts up to a whole tick earlier
        fine = [np.empty((parts * self.segments.ticks, 4)) for _ in range(3)]
        finer = replace(robot, period_s=robot.period_s / parts)
        self._replay(finer, parts, phase * parts, *fine)
        for out, own in zip((speed, seen, duty), fine, strict=True):
            out[:] = own[::parts]

    def _replay(
        self,
        robot: RobotParameters,
        parts: int,
        phase: float,
        speed: Array,
        seen: Array,
        duty: Array,
    ) -> None:
        """Run the drive, each tick of the log in some parts."""
        run_drive(
            pack(robot),
            self._rest,
            State.zeros(),
            self.segments.first * parts,
            self._inputs,
            np.repeat(self._row, parts),
            np.repeat(self._volts, parts),
            self._speed_0,
            phase,
            Outputs.zeros(),
            speed,
            seen,
            duty,
        )

    def candidates(self) -> list[Candidate]:
        """Return the causes of the drive, its controller and the log's speeds."""
        return drive_candidates(periods_shown(self.log))

    def signals(self, terms: Mapping[str, float], poses: Array) -> Mapping[str, Array]:
        """Return shown speed, duty and angle of every wheel at every tick."""
        del poses
        _, seen, duty = self.simulate(terms)
        angle = np.cumsum(seen, axis=0) * (RAD_S_PER_RPM * self.segments.period_s)
        angle = np.mod(angle, 2.0 * np.pi)
        found: dict[str, Array] = {}
        for w, wheel in enumerate(WHEELS):
            found |= {SPEEDS[w]: seen[:, w], DUTIES[w]: duty[:, w]}
            found[f"wheel.{wheel}.angle_rad"] = angle[:, w]
        return found

    def predict(
        self, terms: Mapping[str, float], poses: Array = NO_POSES, *, keep: bool = False
    ) -> Array:
        """Return what the stack's samples would be.

        If the log itself is rounded, its steps are not those of the loop, which show only in how
        the loop responds. With `keep` the run is remembered: predictions that differ from it only
        in what the log makes of the speeds are then cheap.
        """
        del poses
        own = {name: value for name, value in terms.items() if name not in SCALES}
        last = self._last
        if last is not None and last[0] is self.stack and last[1] == own:
            shown = last[2].copy()
        else:
            shown = self._shown(own)
            if keep:
                self._last = self.stack, own, shown.copy()
        for name, term in SPEED_SCALES.items():
            if term in terms and name in self.stack.edges:
                shown[self.stack.edges[name]] *= terms[term]
        return shown

    def _shown(self, terms: Mapping[str, float]) -> Array:
        """Run the drive in the arrays of an earlier run: new ones cost half as much as a run."""
        held = terms.get(SPEED_STEP, 0.0) > 0.0
        try:
            seen, duty = self._spare.pop()
        except IndexError:
            seen, duty = (np.empty((self.segments.ticks, 4)) for _ in range(2))
        if held and self._rounded:
            self._run(terms, speed := np.empty_like(seen), seen, duty)
            shown = self.sampled(speed, duty)
        else:
            self._run(terms, seen, seen, duty)
            shown = self.sampled(seen, duty, held=held)
        self._spare.append((seen, duty))
        return shown

    def sampled(self, seen: Array, duty: Array, *, held: bool = False) -> Array:
        """Return dense speeds and duties at the stack's stamps; a duty holds between ticks."""
        stack, out = self.stack, np.empty(len(self.stack))
        for name in stack.channels:
            edge = stack.edges[name]
            is_speed = name in SPEEDS
            wheel = (SPEEDS if is_speed else DUTIES).index(name)
            at = stack.at[edge]
            if not is_speed or held:
                at = np.floor(at + ON_TIME)
            sample(
                seen if is_speed else duty,
                wheel,
                stack.low[edge],
                stack.high[edge],
                at,
                out[edge],
            )
        return out

    def process_only(self, duty: Array) -> Array:
        """Return the speeds of the process alone under a dense duty, shape (ticks, 4): cut point B.

        The duty is taken as it is: a measured one has already passed the limit. The voltage of
        the battery is that of the whole chain and matters only if the plant has a `battery_sag`.
        """
        seen = np.empty((self.segments.ticks, 4))
        run_process(
            pack(self.robot),
            self._rest,
            State.zeros(),
            self.segments.first,
            duty,
            self._volts,
            self._speed_0,
            seen,
        )
        return seen

    def stepped(self, wheel: int) -> Mask:
        """Return at which ticks an input of a wheel changes, shape (ticks,)."""
        others = [INPUTS[name] for w, name in enumerate(SETPOINTS) if w != wheel]
        own = np.delete(self._inputs, others, axis=1)
        differs = np.concatenate([[False], (own[1:] != own[:-1]).any(axis=1)])
        changed = (
            np.concatenate([[False], np.diff(self._row) != 0]) & differs[self._row]
        )
        changed[self.segments.first[:-1]] = False
        return np.asarray(changed)

    def since(self, happens: Mask) -> Array:
        """Return the time [s] since something last happened, or infinity, at every tick."""
        tick = np.arange(self.segments.ticks)
        last = np.maximum.accumulate(np.where(happens, tick, -1))
        begin = np.repeat(self.segments.first[:-1], np.diff(self.segments.first))
        return np.where(last < begin, np.inf, (tick - last) * self.segments.period_s)

    @property
    def _commanded(self) -> tuple[str, ...]:
        return SETPOINTS if self.log.has(*SETPOINTS) else TWIST

    def _unknown_s(self) -> Array:
        """Return how long at the start of each segment the commands to the drive are unknown.

        Without set-points this is the whole segment. A machine at rest was commanded to stay so.
        """
        skips_s = np.full(len(self.segments), 0.0 if self._at_rest() else SETTLING_S)
        for i, span in enumerate(self.segments.span.tolist()):
            if not self.has_setpoints(span):
                skips_s[i] = np.inf
                continue
            first_s = max(float(self.log[n].of(span)[0][0]) for n in self._commanded)
            if self._moved(span, first_s):
                skips_s[i] = first_s - self.segments.start_s[i] + SETTLING_S
        return skips_s

    def has_setpoints(self, span: int) -> bool:
        """Return whether the log holds set-points of a span."""
        return all(len(self.log[n].of(span)[0]) for n in self._commanded)

    def _moved(self, span: int, before_s: float) -> bool:
        """Return whether a wheel turned before some time."""
        stretches = [self.log[n].of(span) for n in SPEEDS if n in self.log]
        return any(np.median(np.abs(v[t < before_s])) > MOVING_RPM
                   for t, v in stretches if (t < before_s).any())  # fmt: skip

    def _at_rest(self) -> bool:
        firsts = [abs(self.log[n].of(s)[1][:3]).max(initial=0.0)
                  for n in SPEEDS if n in self.log for s in range(len(self.log.spans))]  # fmt: skip
        return max(firsts, default=0.0) < MOVING_RPM

    def _start(self) -> Array:
        """Return wheel speeds and integrals at the start of each segment, shape (m, 8)."""
        start = np.zeros((len(self.segments), 8))
        if self._at_rest():
            return start
        gain = self.robot.process.gain
        for i, span in enumerate(self.segments.span):
            for w, name in enumerate(SPEEDS):
                if name in self.log:
                    values = self.log[name].of(int(span))[1][:3]
                    start[i, w] = float(np.median(values)) if len(values) else 0.0
            start[i, 4:] = start[i, :4] / gain
        return start

    def _latched(self) -> tuple[Array, Indices]:
        """Return the distinct inputs and which of them is latched at every tick."""
        rows: list[Array] = []
        index = np.zeros(self.segments.ticks, dtype=np.int64)
        channels = {n: c for n, c in INPUTS.items() if n in self.log}
        for i, span in enumerate(self.segments.span):
            now = np.zeros(Inputs.n_words)
            now[INPUTS["drive.enable"]] = 1.0
            if not self.log.has(*SETPOINTS):
                now[INPUTS["control.mode"]] = MODE_TWIST
            changes: dict[int, list[tuple[int, float]]] = {}
            for name, column in channels.items():
                t, v = self.log[name].of(int(span))
                fresh = np.concatenate(
                    [[True] * (len(v) > 0), np.diff(v) != 0.0]
                ).astype(bool)
                ticks = np.ceil(
                    (t - self.segments.start_s[i]) / self.robot.period_s - ON_TIME
                )
                for k, value in zip(ticks[fresh].astype(int), v[fresh], strict=True):
                    changes.setdefault(max(int(k), 0), []).append(
                        (column, float(value))
                    )
            first, end = int(self.segments.first[i]), int(self.segments.first[i + 1])
            index[first:end] = len(rows)
            rows.append(now.copy())
            for k in sorted(changes):
                for column, value in changes[k]:
                    now[column] = value
                if first + k < end:
                    index[first + k : end] = len(rows)
                    rows.append(now.copy())
        return np.array(rows), index

    def _placed(self) -> tuple[Array, Indices]:
        """Return the inputs, with changes moved to the tick that fits the wheels best."""
        ticks = self.segments.ticks
        is_row, measured = np.zeros(ticks, dtype=np.bool_), np.full((ticks, 8), np.nan)
        for name in (*INPUTS, *SPEEDS, *DUTIES):
            if name not in self.log:
                continue
            channel = self.log[name]
            segment, at = self.segments.locate(channel.span, channel.t_s)
            tick = np.rint(at[segment >= 0]).astype(np.int64)
            if name in INPUTS:
                is_row[tick] = True
            else:
                measured[tick, (*SPEEDS, *DUTIES).index(name)] = channel.values[
                    segment >= 0
                ]
        dense = self._inputs[self._row]
        place_inputs(
            pack(self.robot),
            self._rest,
            State.zeros(),
            State.zeros(),
            self.segments.first,
            dense,
            self._speed_0,
            is_row,
            measured,
            Outputs.zeros(),
        )
        fresh = np.concatenate([[True], (dense[1:] != dense[:-1]).any(axis=1)])
        fresh[self.segments.first[:-1]] = True
        return dense[fresh], np.cumsum(fresh) - 1

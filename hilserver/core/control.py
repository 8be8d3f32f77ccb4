"""The commands of operators and of the daemon, and what each of them does.

The table in `hilserver.core.transitions` says which state follows a command. In the safe state
the set-points ramp to zero, then the drive is disabled; outputs are still computed, with quality
Uncertain. Only Reset ends it, and only when its cause is gone.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final, Protocol

from hilserver.core.events import Event, EventBus, EventKind
from hilserver.core.inputs import InputGate
from hilserver.core.snapshot import SnapshotStore
from hilserver.core.transitions import Command, next_state
from hilserver.errors import ControlRefused
from hilserver.image import ProcessImage, Row
from hilserver.scheduler import Scheduler
from hilserver.scheduler.faults import fault_of
from hilserver.signals import SignalTable, State

WAITING: Final = (
    "automatic sources wait for Start; hands drive as soon as they were at rest"
)
DRIVING_ON: Final = (
    "automatic sources drive on without Start (control.after_reset: continue)"
)


class Timekeeper(Protocol):
    """Who lets simulated time pass: the scheduler, or a test that stands above it."""

    def resume(self) -> None:
        """Let time pass freely."""

    def pause(self) -> None:
        """Let time stand still."""

    def step(self, n: int) -> None:
        """Let `n` ticks pass, then stand still."""

    def set_speed(self, factor: float) -> None:
        """Let time pass at `factor` times real time."""


class Control:
    """Turns commands of operators and faults of the system into states."""

    def __init__(
        self,
        table: SignalTable,
        image: ProcessImage,
        gate: InputGate,
        events: EventBus,
        scheduler: Scheduler,
        snapshots: SnapshotStore,
        *,
        reset_statistics: Callable[[], None] = lambda: None,
        speed_changed: Callable[[float], None] = lambda _factor: None,
        measured_pose: Callable[[], tuple[float, float, float] | None] = lambda: None,
    ) -> None:
        self.state = State.STARTING
        self.reason = self.state.word
        self.speed = 1.0
        self.reset_statistics = reset_statistics
        self._speed_changed = speed_changed
        self._measured_pose = measured_pose
        self.on_reset: list[Callable[[], None]] = []
        self.before_reset: list[Callable[[], None]] = []  # may refuse it
        self.on_acknowledge: Callable[[], None] = lambda: None
        self._table = table
        self._image = image
        self._gate = gate
        self._events = events
        self._time: Timekeeper = scheduler
        self.stands = False  # between two steps, in every state
        self._snapshots = snapshots
        self._causes: dict[str, str] = {}
        self._stop_taken = 0
        self._pose_requests = 0.0
        snapshots.restored.append(self._adopt_interlock)

    @contextmanager
    def time_kept_by(self, keeper: Timekeeper) -> Iterator[None]:
        """Let `keeper` say when time passes; it stands between steps, so every state takes Step."""
        before = self._time, self.stands
        self._time = keeper
        self.stands = True
        try:
            yield
        finally:
            self._time, self.stands = before

    def _go(self, state: State, reason: str) -> None:
        if state is self.state and reason == self.reason:
            return
        self.state = state
        self.reason = reason
        self._image.control.state = state
        if state is State.SAFE:
            way_out = (
                "call Reset once this has cleared"
                if self._causes
                else "call Reset to resume"
            )
            text = f"{reason}; {way_out}"
            self._events.publish(Event(EventKind.SAFE_STATE, 800, "daemon", text))
        else:
            self._events.publish(Event(EventKind.STATE, 200, "daemon", reason))

    def _next(self, command: Command) -> State:
        try:
            return next_state(self.state, command)
        except ControlRefused as refused:
            because = "" if self.reason == self.state.word else f" ({self.reason})"
            raise ControlRefused(f"{refused}{because}") from None

    def started(self) -> None:
        """Leave `STARTING`: the first ticks are done."""
        state = self._next(Command.STARTED)
        if state is not self.state:
            self._go(state, state.word)

    def start(self) -> None:
        """Resume after a pause; after a safe state, let automatic sources drive again."""
        state = self._next(Command.START)
        self._time.resume()
        self._gate.interlock.release()
        self._go(state, state.word)

    def pause(self) -> None:
        """Stop the plant at the next tick; inputs and outputs stay visible."""
        state = self._next(Command.PAUSE)
        self._time.pause()
        self._gate.end()
        self._go(state, state.word)

    def step(self, n: int) -> None:
        """Run exactly `n` ticks, then pause again."""
        if not 1 <= n <= 1_000_000:
            raise ValueError(f"Step takes 1 to 1000000 ticks, not {n}")
        if not self.stands:
            self._next(Command.STEP)
        self._time.step(n)

    def stop(self) -> None:
        """Emergency stop: go to the safe state."""
        self._next(Command.STOP)
        self._image.control.stop_request = time.monotonic_ns()
        self._take_stop()

    def _take_stop(self) -> None:
        """Take over a Stop, from any source, that the plant obeys already."""
        pressed = self._image.control.stop_request
        if pressed != self._stop_taken:
            self._stop_taken = pressed
            self.enter_safe("stopped by command", cause=None)

    def enter_safe(self, reason: str, *, cause: str | None) -> None:
        """Ramp the set-points to zero and disable the drive.

        Reset works once the condition `cause` has ended (`clear_cause`); at once if it is None.
        """
        if cause is not None:
            self._causes[cause] = reason
        state = self._next(Command.FAULT)
        if state is self.state:
            return
        if self.state is State.PAUSED:
            self._time.resume()
        self._gate.may_fall_back = False
        self._go(state, reason)

    def clear_cause(self, cause: str) -> None:
        """Note that a condition has ended: Reset may acknowledge the safe state now."""
        ended = self._causes.pop(cause, None)
        if ended is not None and not self._causes and self.state is State.SAFE:
            text = f"the cause of the safe state has cleared ({ended}): call Reset to resume"
            self._events.publish(Event(EventKind.STATE, 300, "daemon", text))

    def reset(self) -> None:
        """Acknowledge the safe state; otherwise put the simulation back to its start.

        ControlRefused, and nothing has changed, if one of `before_reset` refuses.
        """
        for callback in self.before_reset:
            callback()
        state = self._next(Command.RESET)
        if self.state is State.SAFE:
            if self._causes:
                raise ControlRefused(
                    f"Reset is not possible yet: {'; '.join(self._causes.values())}"
                )
            self.on_acknowledge()
            self._gate.end()
            self._gate.interlock.engage()
            self._image.control.first_fault = 0
            self._image.control.stop_acknowledged = self._stop_taken
            # Only what a silence has disabled: a host may have disabled the drive itself.
            if not self._gate.is_disabled_by_host:
                self._image.push([Row(self._table.slot("drive.enable"), 1.0)])
            self._go(state, WAITING if self._gate.interlock.waits else state.word)
            if not self._gate.interlock.must_wait:
                self._events.publish(Event(EventKind.STATE, 200, "daemon", DRIVING_ON))
            return
        self._snapshots.reset()
        self._gate.end_waiting()
        for callback in self.on_reset:
            callback()
        self._events.publish(Event(EventKind.STATE, 200, "daemon", "simulation reset"))

    def _adopt_interlock(self) -> None:
        """Let automatic sources wait if they did so in the state that was restored."""
        self._gate.interlock.adopt()
        if not self._gate.interlock.waits:
            return
        # A command that came while the state was restored began a lease that none may renew now.
        self._gate.end()
        if self.state is State.RUNNING:
            self._go(self.state, WAITING)

    def set_pose(self, x_m: float, y_m: float, yaw_rad: float) -> None:
        """Put the robot at a pose at the next tick.

        ValueError if a number is not finite or outside the range of the world.
        """
        values = {
            "internal.pose_x_m": x_m,
            "internal.pose_y_m": y_m,
            "internal.pose_yaw_rad": yaw_rad,
        }
        for name, value in values.items():
            signal = self._table[name]
            if not signal.low <= value <= signal.high:
                place = name.removeprefix("internal.")
                raise ValueError(
                    f"{place} = {value} is outside {signal.low:g} .. {signal.high:g}"
                )
        request = self._table.slot("internal.pose_request")
        self._pose_requests = (
            max(self._pose_requests, self._image.frame_values[request]) + 1
        )
        counter = Row(request, self._pose_requests)
        rows = [Row(self._table.slot(name), value) for name, value in values.items()]
        self._image.push([*rows, counter])

    def align_pose(self) -> None:
        """Put the robot where the measured one is (shadow mode).

        ControlRefused while no measured pose comes in.
        """
        pose = self._measured_pose()
        if pose is None:
            raise ControlRefused(
                "AlignPose needs measured.pose.x_m, y_m and yaw_rad, or measured.nav.*, with"
                " status Good"
            )
        self.set_pose(*pose)

    async def save_snapshot(self, name: str) -> None:
        """Save the whole state under a plain file name."""
        await self._snapshots.save(name)

    async def load_snapshot(self, name: str) -> None:
        """Continue from a saved state; version, kernels, signals and parameters have to match."""
        self._next(Command.LOAD_SNAPSHOT)
        # Twice: for what came before the plant has jumped, and for what comes until we notice it.
        await self._snapshots.load(name, end_commands=self._gate.end_waiting)
        self._gate.end_waiting()

    def set_speed(self, factor: float) -> None:
        """Run at `factor` times real time (0.01 .. 100)."""
        if not 0.01 <= factor <= 100:
            raise ValueError(f"the speed factor must be 0.01 to 100, not {factor}")
        self._time.set_speed(factor)
        self.speed = factor
        self._speed_changed(factor)

    def stopping(self, reason: str) -> None:
        """Enter the final state."""
        self._go(self._next(Command.END), reason)

    def supervise(self) -> None:
        """Take over what the plant has already done, and end what departed clients commanded."""
        self._take_stop()
        self._gate.interlock.show()
        if code := self._image.control.first_fault:
            self.enter_safe(fault_of(code).text, cause=None)
        if not self._gate.end_departed() and self.state is not State.PAUSED:
            why = "the input queue is full: the set-points of a client that has left did not end"
            self.enter_safe(why, cause=None)

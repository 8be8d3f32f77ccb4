"""The robot in a test: a daemon that advances on request of the test, or in real time."""

import asyncio
import inspect
import math
import os
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping, Sequence
from contextlib import (
    AbstractAsyncContextManager,
    AsyncExitStack,
    asynccontextmanager,
    closing,
    suppress,
)
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any, Concatenate, Literal, ParamSpec, Self, TypeVar

from hilserver.core.refusal import Refusal
from hilserver.daemon.daemon import Daemon
from hilserver.errors import ConfigError, ControlRefused, no_signal
from hilserver.faults.model import Fault, parse_fault
from hilserver.image import Frame
from hilserver.program.guest import Guest, NotStarted, filled, guest
from hilserver.signals import Signal
from hilserver.testing.journal import Journal
from hilserver.testing.lockstep import (
    REMEDY,
    WAIT_FOR_STEP_S,
    Lockstep,
    NotInStep,
    outsider,
)
from hilserver.testing.tap import Capture, Tap
from hilserver.testing.tape import Tape
from hilserver.time_limit import time_limit

__tracebackhide__ = True  # pytest then shows the failing line of the test
Mode = Literal["virtual", "realtime"]
Value = float | bool | list[float]
P = ParamSpec("P")
T = TypeVar("T")
DRAIN_EVERY_S = 0.1
DEFAULT_WAIT_S = 10.0  # of `Hil.wait_for`
WATCH_EVERY_S = 0.002
GONE_WITHIN_S = 10.0
OWN_CLOCKS = {"peer": "peers", "ros2": "ros2"}
"""Sections of sources that drive by a clock of their own."""
ENDPOINT = "{endpoint}"
LATE_FACTOR, LATE_S = 5.0, 10.0
"""In real time a step may take its duration times the first plus the second, in wall time."""


class HilError(AssertionError):
    """The simulation has refused a request of the test; one sentence says which."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One value of one signal, and its time."""

    value: float
    tick: int
    time_s: float


def _check_time(what: str, seconds: Any) -> None:
    is_number = isinstance(seconds, int | float) and not isinstance(seconds, bool)
    if not (is_number and 0.0 < seconds < math.inf):
        raise HilError(f"{what} is a time above 0 s, not {seconds!r}")


def _to_await(
    method: Callable[Concatenate["Hil", P], Coroutine[Any, Any, T]],
) -> Callable[Concatenate["Hil", P], Coroutine[Any, Any, T]]:
    """Note every call until it is awaited: what a test forgets to await does nothing."""

    @wraps(method)
    def call(
        hil: "Hil", /, *args: P.args, **options: P.kwargs
    ) -> Coroutine[Any, Any, T]:
        made = method(hil, *args, **options)
        hil._calls = [*hil._not_begun(), made]
        return made

    return call


class Hil:
    """The robot under a test."""

    def __init__(self, daemon: Daemon, mode: Mode, folder: Path | None = None) -> None:
        self.folder = folder  # of the test, in which its controller runs
        # everything else: its OPC UA server, its control, its events
        self.daemon = daemon
        # ``virtual``: time stands still between steps. ``realtime``: it runs
        self.mode = mode
        self.source = daemon.gate.owner
        self.tap, self.tape = Tap(daemon.image), Tape(daemon)
        self.journal = Journal()
        self._period_s = daemon.assembly.base_period_ns * 1e-9
        self._chunk = max(1, daemon.config.image.ring_frames // 2)
        self._calls: list[Any] = []  # coroutines
        self._lockstep: Lockstep | None = None  # while a controller steps
        self._controller: Guest | None = None
        # clients of this process, and controllers that have stepped
        self._insiders: set[object] = set()
        self._controllers_made = self._controllers_begun = 0

    # --- time -------------------------------------------------------------------------------------

    @property
    def tick(self) -> int:
        """Number of the next tick."""
        return self.daemon.scheduler.tick

    @property
    def time_s(self) -> float:
        """Simulated time [s]."""
        return self.tick * self._period_s

    @_to_await
    async def step(self, n: int = 1) -> None:
        """Advance by `n` ticks: exactly in virtual time, at least in real time."""
        if isinstance(n, bool) or not isinstance(n, int) or n < 1:
            raise HilError(f"a step is a whole number of ticks from 1 on, not {n!r}")
        if self.mode == "realtime":
            await self._wait_ticks(n)
            self.tap.drain()
            return
        while n > 0:
            ticks = min(n, self._chunk)
            await self._advance(ticks)
            self.tap.drain()
            await self.tape.keep_up()
            n -= ticks

    async def _advance(self, n: int) -> None:
        """Let `n` ticks of virtual time pass."""
        self._check_runs()
        if self._lockstep is None:
            # Time would wait for neither of these: the same test would pass once and fail once.
            section = OWN_CLOCKS.get(self.daemon.gate.owner, "")
            for part in self.daemon.parts_of(section):
                others = part.others if section == "ros2" else {part}
                if part.status.connected and others - self._insiders:
                    raise HilError(
                        f"{section}: '{part.status.name}' is connected and drives by a clock of its"
                        f" own; {REMEDY}"
                    )
            strangers = self.daemon.gate.present - self._insiders
            if address := outsider(strangers):
                raise HilError(
                    f"a controller in another process ({address}) commands the robot, which does"
                    " not wait for it: run it by 'async with hil.controller(...)', where it calls"
                    f" Step; {REMEDY}"
                )
            self._insiders |= strangers
            await self.daemon.scheduler.advance(n)
            return
        await self._until(self._lockstep.advance(n))

    @staticmethod
    async def _until(in_step: Coroutine[Any, Any, T]) -> T:
        try:
            return await in_step
        except NotInStep as why:
            raise HilError(str(why)) from None

    @_to_await
    async def run_for(self, seconds: float) -> None:
        """Advance by simulated `seconds`, rounded to ticks."""
        _check_time("run_for", seconds)
        await self.step(max(1, round(seconds / self._period_s)))

    async def _wait_ticks(self, n: int) -> None:
        scheduler = self.daemon.scheduler
        goal = scheduler.ticks_done + n
        limit_s = time.monotonic() + n * self._period_s * LATE_FACTOR + LATE_S
        while (left := goal - scheduler.ticks_done) > 0:
            self._check_runs()
            if time.monotonic() > limit_s:
                raise HilError(self._not_in_time(f"{n} ticks"))
            await asyncio.sleep(
                min(max(left * self._period_s * 0.9, 0.0002), DRAIN_EVERY_S)
            )

    def _not_in_time(self, what: str) -> str:
        return f"{what} did not pass in time; the daemon is {self.daemon.control.state.word}"

    def _check_runs(self) -> None:
        if self._controller is not None and self._controller.has_failed:
            how = self._controller.ending
            if self.mode == "realtime" and "BadInvalidState" in how:
                how += "; in real time the robot waits for nobody, and Step is refused"
            raise HilError(f"the controller {how}")
        if self.daemon.scheduler.finished.done():
            raise HilError(
                f"the simulation has ended: {self.daemon.scheduler.finished.result()}"
            )

    # --- signals ----------------------------------------------------------------------------------

    def read(self, signal: str) -> float:
        """Return the newest value of a scalar signal."""
        return float(self._frame().values[self._slot(signal)])

    def read_all(self, signal: str) -> list[float]:
        """Return the newest values of an array signal."""
        frame = self._frame()
        return [float(frame.values[slot]) for slot in self._signal(signal).slots]

    def status(self, signal: str) -> int:
        """Return the newest OPC UA status code of a scalar signal."""
        return int(self._frame().status[self._slot(signal)])

    def write(
        self, signal: str | Mapping[str, Value], value: Value | None = None
    ) -> None:
        """Write one input, or several that one tick latches together.

        HilError if any of them is refused.
        """
        values = {signal: value} if isinstance(signal, str) else dict(signal)
        for name in values:
            self._signal(name)
        tick = self.tick
        refused = self.daemon.gate.write(self.source, values)
        if refused:
            raise HilError(
                "; ".join(self._why(n, values[n], r) for n, r in refused.items())
            )
        self.journal.wrote(tick * self._period_s, values)

    @_to_await
    async def set_parameter(self, name: str, value: float | str | None) -> int:
        """Change a parameter, named as in config.yaml; return the first tick with the new value.

        HilError if it is refused.
        """
        tick, parameters = self.tick, self.daemon.core.parameters
        try:
            number = parameters.apply(parameters.checked({name: value}))
            taken = await parameters.taken(number)
        except (ConfigError, ControlRefused) as error:
            raise HilError(str(error)) from None
        self.journal.wrote(tick * self._period_s, {name: value}, key="set")
        return taken

    def _why(self, name: str, value: object, reason: Refusal) -> str:
        why = reason.value.replace("_", " ")
        if reason is Refusal.OUT_OF_RANGE:
            why += f", {self._signal(name).range_text}"
        return f"{name} = {value!r} was refused: {why}"

    def _signal(self, name: str) -> Signal:
        if name not in self.daemon.table:
            raise HilError(
                no_signal(name, (signal.name for signal in self.daemon.table))
            )
        return self.daemon.table[name]

    def _slot(self, name: str) -> int:
        signal = self._signal(name)
        if signal.is_array:
            raise HilError(
                f"'{name}' is an array; take one of its scalars, or read_all"
            )
        return signal.slots[0]

    def _frame(self) -> Frame:
        frame = self.daemon.image.latest()
        if frame is None:
            raise HilError("there is no frame yet; step once")
        return frame

    @_to_await
    async def wait_for(
        self,
        signal: str,
        predicate: Callable[[float], bool],
        timeout: float | None = None,  # noqa: ASYNC109 - of simulated time
        *,
        timeout_s: float = DEFAULT_WAIT_S,
    ) -> Sample:
        """Advance until a value of `signal` satisfies `predicate`; every tick is checked.

        `timeout`, or `timeout_s`: simulated time [s]. HilError if no value does within it; it has
        the last value.
        """
        timeout_s = timeout_s if timeout is None else timeout
        _check_time("the timeout of wait_for", timeout_s)
        if not callable(predicate):
            raise HilError(
                "wait_for takes a function of the value, such as lambda x: x > 1, not"
                f" {predicate!r}"
            )
        slot = self._slot(signal)
        self.tap.drain()
        frame = self.daemon.image.latest()
        frames = [] if frame is None else [frame]
        last_tick = self.tick + round(timeout_s / self._period_s)
        late_s = time.monotonic() + timeout_s * LATE_FACTOR + LATE_S
        value = math.nan
        while True:
            for frame in frames:
                value = float(frame.values[slot])
                if predicate(value):
                    return Sample(value, frame.tick, frame.tick * self._period_s)
            if self.tick >= last_tick:
                raise HilError(
                    f"{signal} did not get there in {timeout_s:g} s; it is {value:g}"
                )
            if self.mode == "realtime" and time.monotonic() > late_s:
                raise HilError(self._not_in_time(f"{timeout_s:g} s"))
            frames = await self._next_frames()

    async def _next_frames(self) -> list[Frame]:
        if self.mode == "virtual":
            await self._advance(1)
            await self.tape.keep_up()
        else:
            self._check_runs()
            await asyncio.sleep(WATCH_EVERY_S)
        return self.tap.drain()

    def capture(self, *signals: str) -> Capture:
        """Return an async context manager that records every tick of `signals`."""
        found = [self._signal(name) for name in signals] or [
            signal for signal in self.daemon.table if not signal.is_array
        ]
        return Capture(self.tap, self.daemon.table, found, self._period_s)

    @property
    def endpoint(self) -> str:
        """Address of the daemon's OPC UA server, for a controller that is its client.

        HilError if the configuration has none.
        """
        server = self.daemon.part("opcua")
        if server is None:
            raise HilError(
                "this robot has no OPC UA server: set opcua.enabled in its configuration"
            )
        return str(server.url)

    # --- controllers ------------------------------------------------------------------------------

    def controller(
        self, *command: str | Path, patience_s: float = WAIT_FOR_STEP_S, **options: Any
    ) -> AbstractAsyncContextManager[None]:
        """Return an async context manager that runs a controller as a process.

        It is an OPC UA client or, where ROS 2 is the source, a node, which gets the robot's
        ``ROS_DOMAIN_ID``. In virtual time the two wait for each other: the controller calls
        ``Step(n)``, waits until ``sim.tick`` has risen by n, and computes; a node calls the service
        ``hilserver/step`` for each message. In real time it has a clock of its own.

        HilError if the process cannot be started or fails or, in virtual time, if it does not call
        Step within `patience_s` [s].

        Parameters
        ----------
        *command
            Program and arguments; ``{endpoint}`` stands for the robot's address. Without a command
            somebody else starts it.
        **options
            As for `subprocess.Popen`: ``env``, ``cwd`` (by default the folder of the test) ...
        """
        self._controllers_made += 1
        return self._with_controller(command, patience_s, options)

    @asynccontextmanager
    async def _with_controller(
        self, command: Sequence[str | Path], patience_s: float, options: dict[str, Any]
    ) -> AsyncIterator[None]:
        self._controllers_begun += 1
        if self._lockstep is not None or self._controller is not None:
            raise HilError(
                "there is a controller already, and only one steps the robot"
            )
        gate, node = self.daemon.gate, self.daemon.part("ros2")
        is_node = gate.owner == "ros2" or not self.daemon.part("opcua")
        door = "ros2" if node is not None and is_node else "opcua"
        if gate.owner == "scenario" and not self.daemon.stage.drives:
            gate.take(door)  # else the controller's commands would be refused
            self.source = gate.owner
        needs_endpoint = door == "opcua" or any(ENDPOINT in str(w) for w in command)
        own = {ENDPOINT: self.endpoint} if needs_endpoint else {}
        if door == "ros2":
            env = dict(options.get("env") or os.environ)
            options = options | {"env": env | {"ROS_DOMAIN_ID": str(node.domain)}}

        async with AsyncExitStack() as ending:
            if command:
                words = [filled(str(word), own) for word in command]
                program = guest(words, **({"cwd": self.folder} | options))
                try:
                    self._controller = await ending.enter_async_context(program)
                except NotStarted as error:
                    raise HilError(str(error)) from None
                tasks, reading = self.daemon.core.tasks, self._controller.wait
                job = tasks.spawn(reading, "controller of a test")
                ending.callback(job.cancel)
            ending.callback(self._let_controller_go)
            if self.mode == "virtual":
                who = self.daemon, self._controller
                self._lockstep = Lockstep(*who, patience_s, door)
                ending.enter_context(self.daemon.control.time_kept_by(self._lockstep))
            yield
            self._check_runs()
            if self._lockstep is not None and self._lockstep.steps < 1:
                raise HilError(
                    "the controller has not called Step while its block ran: advance inside the"
                    " block, with yield or await hil.step(...)"
                )
            if self._lockstep is not None:
                self._insiders |= await self._until(self._lockstep.settle())
        # The set-points of a client that has left end: in this tick, not in one by chance.
        with suppress(TimeoutError):
            async with time_limit(GONE_WITHIN_S):
                while command and outsider(self.daemon.gate.present):  # noqa: ASYNC110
                    await asyncio.sleep(WATCH_EVERY_S)

    def _let_controller_go(self) -> None:
        self._lockstep = self._controller = None

    # --- faults -----------------------------------------------------------------------------------

    def inject(self, *faults: Mapping[str, object] | Fault | str) -> list[str]:
        """Inject faults from the next tick on; a string names one of the shield's defects."""
        try:
            parsed = [
                parse_fault({"fault": f} if isinstance(f, str) else f) for f in faults
            ]
            now_s = self.time_s
            names = self.daemon.faults.inject(*parsed)
        except ValueError as error:
            raise HilError(str(error)) from None
        for fault in parsed:
            self.journal.injected(now_s, fault)
        return names

    def clear_faults(self, name: str | None = None) -> None:
        """End the fault `name`, or all; forces remain."""
        try:
            self.daemon.faults.clear(name)
        except ValueError as error:
            raise HilError(str(error)) from None
        self.journal.cleared(self.time_s, name)

    def force(self, signal: str, value: float) -> None:
        """Hold a signal at a value."""
        self.inject({"fault": "force", "signal": signal, "value": value})

    def unforce(self, signal: str) -> None:
        """Release a forced signal."""
        self.clear_faults(f"force:{signal}")

    # --- life -------------------------------------------------------------------------------------

    @asynccontextmanager
    async def running(self) -> AsyncIterator[Self]:
        """Run the daemon while the context lasts."""
        with closing(self.tape):
            async with self.daemon:
                job = self.daemon.core.tasks.every("tap", DRAIN_EVERY_S, self._drain)
                try:
                    await self.step(1)
                    yield self
                finally:
                    job.cancel()

    def check_awaited(self) -> None:
        """HilError if a call was not awaited, or a controller not begun."""
        forgotten = self._not_begun()
        for call in forgotten:
            call.close()
        if forgotten:
            name = forgotten[0].__name__
            raise HilError(
                f"hil.{name} was called without await, so nothing happened: write 'await"
                f" hil.{name}(...)' in a test that is an async def"
            )
        if self._controllers_made > self._controllers_begun:
            raise HilError(
                "hil.controller was called without async with, so no controller ran: write 'async"
                " with hil.controller(...):'"
            )

    def _not_begun(self) -> list[Any]:
        return [
            c
            for c in self._calls
            if inspect.getcoroutinestate(c) == inspect.CORO_CREATED
        ]

    async def _drain(self) -> None:
        if self.mode == "realtime":
            self.tap.drain()
            await self.tape.keep_up()

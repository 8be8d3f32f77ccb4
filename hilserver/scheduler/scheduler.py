"""The scheduler: a fixed step, several time slices, one of three pacing back ends.

Usage::

    scheduler = Scheduler(
        base_period_ns=1_000_000,
        slices=[Slice("plant", 1, compiled=True), Slice("publish", 20, compiled=False)],
        step=step, values=values, words=words,
    )
    scheduler.on_slice("publish", publish)
    await scheduler.start()
    reason = await scheduler.finished

All methods belong to the thread of the event loop on which `start` was called.
"""

import asyncio
from collections.abc import Awaitable, Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from hilserver.errors import FailedError
from hilserver.scheduler import exchange as ex
from hilserver.scheduler.causes import CauseFinder
from hilserver.scheduler.communication import Communication, SliceCallback
from hilserver.scheduler.gc_pauses import GcPauses
from hilserver.scheduler.law import CONSECUTIVE_LIMIT, SINGLE_LIMIT
from hilserver.scheduler.machine import Machine
from hilserver.scheduler.overruns import OverrunCallback, Overruns
from hilserver.scheduler.pacing import Pacing, StopReason
from hilserver.scheduler.pacing_thread import ThreadPacing
from hilserver.scheduler.pacing_timerfd import TimerfdPacing
from hilserver.scheduler.pacing_virtual import VirtualPacing
from hilserver.scheduler.policies import OverrunLimits, OverrunPolicy
from hilserver.scheduler.realtime import AuditFinding, RealtimeSettings
from hilserver.scheduler.slices import Slice
from hilserver.scheduler.statistics import Statistics
from hilserver.scheduler.step import StepFunction
from hilserver.tasks import Supervisor
from hilserver.time_limit import time_limit

BACKENDS = ("thread", "timerfd", "virtual")
SPEED_LOW, SPEED_HIGH = 0.01, 100.0


class PeerSilentError(FailedError):
    """The other side of a lockstep did not answer in time."""


class Scheduler:
    """Runs the compiled step by tick count; see the module for usage.

    Parameters
    ----------
    base_period_ns
        Duration of a tick [ns], simulated and (at speed 1) real.
    slices
        Compiled slices, in the order of the step's phases, and communication slices.
    step
        Compiled with ``kernel(STEP_SIGNATURE)``; see `hilserver.scheduler.step`.
    values, words
        Passed through to the step: float64 and int64, flat, contiguous.
    backend
        ``thread``, ``timerfd`` or ``virtual``.
    policy, limits
        What happens when a tick is a whole period late, and which overruns are tolerated.
    realtime
        What to request from the operating system; `grants` holds the answers.
    warm_up_ticks
        Number of ticks at the start that are executed but neither counted nor judged.
    first_tick
        Number of the first tick.
    paused
        True: stand still until `resume` or `step`.
    freeze_gc
        Hide from the garbage collector what is there at the start.
    statistics_array, linear_bins
        See `Statistics`; an array in shared memory can be read by other processes.
    tasks
        Keeps the task of virtual time.
    """

    def __init__(
        self,
        *,
        base_period_ns: int,
        slices: Sequence[Slice],
        step: StepFunction,
        values: NDArray[np.float64],
        words: NDArray[np.int64],
        backend: str = "thread",
        policy: OverrunPolicy | None = None,
        limits: OverrunLimits | None = None,
        realtime: RealtimeSettings | None = None,
        warm_up_ticks: int = 100,
        first_tick: int = 0,
        paused: bool = False,
        freeze_gc: bool = True,
        statistics_array: NDArray[np.int64] | None = None,
        linear_bins: int = 0,
        tasks: Supervisor | None = None,
    ) -> None:
        if backend not in BACKENDS:
            raise ValueError(
                f"pacing {backend!r} is unknown; use one of {', '.join(BACKENDS)}"
            )
        self.backend, self.base_period_ns = backend, base_period_ns
        self.grants: list[AuditFinding] = []
        self.gc_pauses = GcPauses()
        self._freeze_gc, self._started = freeze_gc, False
        self._machine = Machine(
            base_period_ns=base_period_ns,
            slices=slices,
            step=step,
            values=values,
            words=words,
            policy=policy or OverrunPolicy(),
            limits=limits or OverrunLimits(),
            warm_up_ticks=0 if backend == "virtual" else warm_up_ticks,
            first_tick=first_tick,
            statistics_array=statistics_array,
            linear_bins=linear_bins,
        )
        self._exchange = self._machine.exchange
        if paused:
            self._exchange.pause()
        self._overrun_callbacks: list[OverrunCallback] = []
        self._overruns = Overruns(self._machine, self._overrun_callbacks)
        self._communication = Communication(
            self._machine,
            simulated=backend == "virtual",
            on_overrun=self._overruns.communication,
        )
        # called after every batch of ticks in virtual time, which waits for them
        self.after_batch: list[Callable[[], None]] = []
        self._pacing = self._make_pacing(realtime or RealtimeSettings(), tasks)
        self._waiters: list[asyncio.Future[None]] = []

    def _make_pacing(
        self, realtime: RealtimeSettings, tasks: Supervisor | None
    ) -> Pacing:
        if self.backend == "thread":
            return ThreadPacing(self._machine, realtime, self._rung, self._ended)
        if self.backend == "timerfd":
            return TimerfdPacing(self._machine, realtime, self._rung, self._ended)
        return VirtualPacing(
            self._machine, self._rung, self._ended, self.after_batch, tasks
        )

    @property
    def statistics(self) -> Statistics:
        """Statistics since the last reset."""
        return self._machine.statistics

    @property
    def tick(self) -> int:
        """Number of the next tick; simulated time is `tick` times the base period."""
        return self._exchange.get(ex.NEXT_TICK)

    @property
    def ticks_done(self) -> int:
        """How many ticks have been executed; a restore does not change it."""
        return self._exchange.get(ex.TICKS_DONE)

    @property
    def paused(self) -> bool:
        """True when the loop stands still (a pause, or all ticks of a step, are done)."""
        return self._exchange.standing

    @property
    def speed(self) -> float:
        """Intended ratio of simulated to real time."""
        return self.base_period_ns / self._exchange.get(ex.PACED_PERIOD)

    @property
    def heartbeat_ns(self) -> int:
        """When the loop last woke [ns, CLOCK_MONOTONIC]; for a watchdog."""
        return self._exchange.get(ex.HEARTBEAT)

    @property
    def thread_id(self) -> int:
        """The operating system's number of the pacing thread; 0 in virtual time."""
        return self._pacing.thread_id

    def on_slice(self, name: str, callback: SliceCallback) -> None:
        """Call `callback(tick, planned_ns)` in each run of a communication slice."""
        self._communication.add(name, callback)

    def on_overrun(self, callback: OverrunCallback) -> None:
        """Call `callback(report)` on the event loop for every overrun, within about 0.1 s."""
        self._overrun_callbacks.append(callback)

    async def start(self) -> None:
        """Start to run."""
        if self._started:
            raise RuntimeError("a scheduler can start only once; make a new one")
        self._started = True
        self.finished: asyncio.Future[StopReason] = (
            asyncio.get_running_loop().create_future()
        )
        self.gc_pauses.start(freeze=self._freeze_gc)
        try:
            self.grants = await self._pacing.start()
        except BaseException:
            await self.stop()
            raise
        self.statistics.thread_id = self._pacing.thread_id
        if self.backend != "virtual":
            gc_stops_ticks = self.backend == "timerfd"
            self._overruns.start(
                CauseFinder(
                    self._pacing.thread_id,
                    self.gc_pauses,
                    period_ns=self.base_period_ns,
                    gc_stops_ticks=gc_stops_ticks,
                )
            )

    async def stop(self) -> None:
        """End the loop and release everything; may be called twice."""
        if not self._started:
            return
        self._started = False
        self._exchange.request_stop()
        try:
            await self._pacing.stop()
        finally:
            self._overruns.stop()
            self.gc_pauses.stop()

    def pause(self) -> None:
        """Stand still before the next tick; inputs are still latched."""
        self._exchange.pause()
        self._pacing.wake()

    def resume(self) -> None:
        """Run freely; the rest of a step is void."""
        self._exchange.resume()
        self._pacing.wake()

    def step(self, n: int) -> None:
        """Run exactly `n` ticks and stand still; these add to the rest of an unfinished step."""
        self._exchange.step(n)
        self._pacing.wake()

    def set_speed(self, factor: float) -> None:
        """Pace simulated time at `factor` times real time, from the next tick on.

        Virtual time always runs as fast as possible.
        """
        if not SPEED_LOW <= factor <= SPEED_HIGH:
            raise ValueError(
                f"the speed factor is {SPEED_LOW:g} to {SPEED_HIGH:g}, not {factor:g}"
            )
        self._exchange.set_paced_period(max(1, round(self.base_period_ns / factor)))

    def set_limits(self, limits: OverrunLimits) -> None:
        """Change the limits from the next tick on; each is one word that the law reads."""
        ex.write_word(self._machine.law, SINGLE_LIMIT, limits.single_ns)
        ex.write_word(self._machine.law, CONSECUTIVE_LIMIT, limits.consecutive)

    async def wait_paused(self) -> None:
        """Wait until the last `pause` or `step` is done (or the run has ended)."""
        if self.paused or self.finished.done():
            return
        waiter: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiters.append(waiter)
        await waiter

    async def advance(self, n: int) -> None:
        """Run exactly `n` ticks, in any back end, and return when they are done."""
        self.step(n)
        await self.wait_paused()

    async def lockstep(
        self,
        exchange: Callable[[int], Awaitable[bool]],
        *,
        n_ticks: int,
        peer: str,
        timeout_s: float,
    ) -> None:
        """Alternate `n_ticks` of simulation with one `exchange(tick)` with an external controller.

        Ends when `exchange` returns False or the scheduler ends. PeerSilentError if an exchange
        takes longer than `timeout_s` [s].
        """
        while not self.finished.done():
            await self.advance(n_ticks)
            tick = self.tick
            try:
                async with time_limit(timeout_s):
                    goes_on = await exchange(tick)
            except TimeoutError:
                raise PeerSilentError(
                    f"lockstep: {peer} has been silent for {timeout_s:g} s, tick {tick} is waiting"
                    " for it; is it running and connected?"
                ) from None
            if not goes_on:
                return

    def _rung(self) -> None:
        self._communication.dispatch()
        if self._waiters and self.paused:
            self._release_waiters()

    def _ended(self, reason: StopReason) -> None:
        if not self.finished.done():
            self.finished.set_result(reason)
        self._release_waiters()

    def _release_waiters(self) -> None:
        waiters, self._waiters = self._waiters, []
        for waiter in waiters:
            if not waiter.done():
                waiter.set_result(None)

"""An event loop without a computer: time is virtual, idle time takes none, chance is drawn.

What asyncio promises stays: callbacks run in the order in which they became ready, and timers in
the order of their times. What it does not promise is drawn from the seed: which arrivals of
different connections come first, whether they or timers that are due at the same moment do, how
long a turn of the loop takes, when the work of an executor is done.
"""

import asyncio
import heapq
import itertools
import random
from collections.abc import Callable
from typing import Any

from tests.hours.clock import Clock

NS = 1_000_000_000
TURN_NS = (20_000, 200_000)
EXECUTOR_NS = (100_000, 30_000_000)
MOST_TURNS = 100_000  # of one life: far more than any needs


class _Task(asyncio.Task):
    """Sets of tasks have the same order in every run."""

    _numbers = itertools.count()

    def __init__(self, *args: Any, **named: Any) -> None:
        self.number = next(self._numbers)
        super().__init__(*args, **named)

    def __hash__(self) -> int:
        return self.number

    __eq__ = object.__eq__


class _Future(asyncio.Future):
    def __init__(self, *args: Any, **named: Any) -> None:
        self.number = next(_Task._numbers)
        super().__init__(*args, **named)

    def __hash__(self) -> int:
        return self.number

    __eq__ = object.__eq__


def _name_of(limit: asyncio.TimerHandle) -> str:
    """Return the name of the product's task that has this time limit; of all others one."""
    holder = getattr(limit._callback, "__self__", None)
    task = getattr(getattr(holder, "_wait", holder), "_task", None)
    if task is None or "/hilserver/" not in task.get_coro().cr_code.co_filename:
        return ""
    return str(task.get_name())


class StuckError(AssertionError):
    """Nothing is left that could ever happen, or nothing ever rests."""


class VirtualLoop(asyncio.BaseEventLoop):
    """The loop of one simulated world; `network` answers what concerns sockets."""

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self.clock, self.chance = clock, random.Random(0)
        clock.loop = self
        self.network: Any = None
        self.turns = 0
        self.errors: list[dict[str, Any]] = []
        self._clock_resolution = 1e-9
        self._arrivals: list[tuple[int, int, Callable[[], None]]] = []
        self._numbers = itertools.count()
        self.set_task_factory(
            lambda loop, coro, **named: _Task(coro, loop=loop, **named)
        )
        self.set_exception_handler(lambda _loop, context: self.errors.append(context))

    def time(self) -> float:
        return self.clock.now_ns / NS

    def create_future(self) -> asyncio.Future[Any]:
        return _Future(loop=self)

    def arrive(self, at_ns: int, what: Callable[[], None]) -> None:
        """Let something happen from outside at a time."""
        heapq.heappush(self._arrivals, (at_ns, next(self._numbers), what))

    def stand_still(self, seconds: float) -> None:
        """Hold up the loop, as a call that does not return; the plant goes on meanwhile."""
        self.clock.advance_to(self.clock.now_ns + round(seconds * NS))

    def limits(self) -> dict[str, list[float]]:
        """Return when time limits end, by the name of a task: many strangers hide no link."""
        kinds = ("Timeout._on_timeout", "_Prolonging._look", "_release_waiter")
        found: dict[str, list[float]] = {}
        for timer in self._scheduled:
            kind = getattr(timer._callback, "__qualname__", "")
            if not timer._cancelled and kind in kinds:
                found.setdefault(_name_of(timer), []).append(timer.when())
        if len(found) > 1:
            found.pop("", None)  # the product has some
        return found

    # --- one turn ---------------------------------------------------------------------------------

    def _run_once(self) -> None:
        self.turns += 1
        if self.turns > MOST_TURNS:
            raise StuckError(f"no end: {sorted(map(repr, asyncio.all_tasks(self)))}")
        if not self._ready:
            self._wait()
        self._take_what_is_due()
        for _ in range(len(self._ready)):
            handle = self._ready.popleft()
            if not handle._cancelled:
                handle._run()
        self.clock.advance_to(self.clock.now_ns + self.chance.randint(*TURN_NS))

    def _wait(self) -> None:
        """Let time jump to what comes next."""
        while self._scheduled and self._scheduled[0]._cancelled:
            heapq.heappop(self._scheduled)._scheduled = False
        times = [at_ns for at_ns, _, _ in self._arrivals[:1]]
        times += [round(timer._when * NS) + 1 for timer in self._scheduled[:1]]
        if not times and not self._ready:
            raise StuckError("nothing can happen any more")
        self.clock.advance_to(min(times))

    def _take_what_is_due(self) -> None:
        timers, arrived = [], []
        while self._scheduled and self._scheduled[0]._when <= self.time():
            timer = heapq.heappop(self._scheduled)
            timer._scheduled = False
            if not timer._cancelled:
                timers.append(timer)
        while self._arrivals and self._arrivals[0][0] <= self.clock.now_ns:
            what = heapq.heappop(self._arrivals)[2]
            arrived.append(asyncio.Handle(what, (), self))
        if len(arrived) > 1:
            self.chance.shuffle(arrived)
        groups = [timers, arrived]
        if timers and arrived and self.chance.random() < 0.5:
            groups.reverse()
        for group in groups:
            self._ready.extend(group)

    # --- what a computer would do -----------------------------------------------------------------

    def call_soon_threadsafe(
        self, callback: Any, *args: Any, context: Any = None
    ) -> Any:
        return self.call_soon(callback, *args, context=context)

    def run_in_executor(
        self, _executor: Any, function: Any, *args: Any
    ) -> asyncio.Future[Any]:
        """Do the work at once, but be ready with it later."""
        future = self.create_future()

        def done() -> None:
            if future.done():
                return
            try:
                result = function(*args)
            except BaseException as error:  # noqa: BLE001 - whoever waits gets it
                future.set_exception(error)
            else:
                future.set_result(result)

        self.arrive(self.clock.now_ns + self.chance.randint(*EXECUTOR_NS), done)
        return future

    async def create_connection(
        self, factory: Any, host: Any = None, port: Any = None, **_: Any
    ):
        return await self.network.connect(factory, host, port)

    async def create_server(
        self, factory: Any, host: Any = None, port: Any = None, **_: Any
    ):
        return self.network.listen(factory, host, port)

    def _process_events(self, _events: Any) -> None:
        """There is no selector."""

    def _write_to_self(self) -> None:
        """Nobody else writes."""


def run_in(loop: VirtualLoop, work: Any) -> Any:
    """Run a coroutine to its end in virtual time."""
    loop.clock.is_running = True
    try:
        return loop.run_until_complete(work)
    finally:
        loop.clock.is_running = False

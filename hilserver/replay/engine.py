"""The plant alone, in virtual time, fed with rows and compared with a log."""

from collections import deque
from collections.abc import AsyncIterator, Mapping
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from hilserver.daemon.assembly import Assembly
from hilserver.daemon.builder import Pace, build
from hilserver.errors import ConfigError, LogError
from hilserver.faults.model import parse_fault
from hilserver.image import read_frames
from hilserver.image.changes import Changes
from hilserver.logs import Log, RecordedState
from hilserver.logs.log import Change
from hilserver.logs.provenance import FaultCommand
from hilserver.logs.writer import Segmented
from hilserver.replay.plan import Stretch
from hilserver.signals import Direction, SignalTable
from hilserver.signals import State as DaemonState
from hilserver.status import BAD

QUEUE_ROWS = 1 << 17
RING_FRAMES = 1 << 11
BATCH_TICKS = 1 << 10
IN_ROWS = -1
_OF_THE_CONFIGURATION = ("parameters", "base_period_ns", "slices")


class Engine:
    """Plays stretches through the plant of a configuration; an asynchronous context manager."""

    def __init__(self, assembly: Assembly) -> None:
        self._core = build(
            assembly, Pace(ring_frames=RING_FRAMES, queue_rows=QUEUE_ROWS)
        )
        self.assembly = assembly
        self.table = assembly.table
        self.image = self._core.image
        self._changes = Changes(self.image)
        self._store = self._core.snapshots
        self._fresh = self._core.snapshots.initial

    async def __aenter__(self) -> Self:
        await self._core.__aenter__()
        return self

    async def __aexit__(self, *exception: object) -> None:
        await self._core.__aexit__(*exception)

    def check(
        self, what: str, identity: Mapping[str, Any], state: NDArray[np.int64]
    ) -> None:
        """Refuse a log or state whose kernels or configuration would give other bits.

        ConfigError if the configuration differs; LogError if version, kernels or signals differ, or
        the state is of another size.
        """
        key = self._store.differs_in(identity)
        if key is not None:
            here, there = (
                str(i.get(key))[:16] for i in (self._store.identity, identity)
            )
            kind = ConfigError if key in _OF_THE_CONFIGURATION else LogError
            if kind is ConfigError:
                remedy = "use the configuration of its run"
            else:
                remedy = "use the hilserver of its run"
            raise kind(
                f"{what}: was made with {key} {there}, but here it is {here}; {remedy}, or"
                " replay its"
                " set-points with --as-inputs"
            )
        if len(state) != self._store.state_words:
            raise LogError(
                f"{what}: contains a state of a different size; the file is probably incomplete"
            )

    def feed_state(self, *, in_rows: bool) -> None:
        """Set whether the daemon's state comes with the rows, or is always ``running``."""
        self.image.control.state = IN_ROWS if in_rows else DaemonState.RUNNING

    def _command(self, command: FaultCommand) -> None:
        """Inject or end faults as in the recorded run, before the next tick."""
        book = self._core.faults
        try:
            given = [parse_fault(fault) for fault in command.inject]
            # Those of a link have changed inputs, which are recorded.
            here = [fault for fault in given if fault.peer is None]
            book.inject(*here, start_tick=command.start_tick)
            known = [None, *(fault.name for fault in book.active())]
            if not given and command.clear in known:
                book.clear(command.clear)
        except ValueError as error:
            raise LogError(f"the fault at tick {command.tick}: {error}") from None

    def start_of(self, stretch: Stretch) -> RecordedState:
        """Return the state with which a stretch begins."""
        words = self._fresh if stretch.state is None else stretch.state
        return RecordedState(stretch.segment, stretch.first_tick, words)

    async def play(self, stretch: Stretch) -> AsyncIterator[Segmented]:
        """Run a stretch; yield its frames."""
        await self._store.restore(self.start_of(stretch).words, stretch.first_tick)
        rows = stretch.rows
        period_ns = self.assembly.base_period_ns
        changes = deque(stretch.changes)
        faults = deque(stretch.faults)
        number = self.image.head
        done = 0
        while done < stretch.n_ticks:
            n = min(BATCH_TICKS, stretch.n_ticks - done)
            while faults and faults[0].tick <= stretch.first_tick + done:
                self._command(faults.popleft())
            if faults:
                n = min(n, faults[0].tick - stretch.first_tick - done)
            # The changes before that tick, as far as there is room.
            until = stretch.first_tick + done + n
            posted: list[Change] = []
            while changes and changes[0].tick < until and self._changes.room:
                change = changes.popleft()
                if change.packed.size != self._changes.length:
                    raise LogError(
                        f"the change at tick {change.tick} belongs to another configuration"
                    )
                self._changes.post(change.number, change.packed, change.tick)
                posted.append(change)
            if changes:
                n = min(n, changes[0].tick - stretch.first_tick - done)
            last_tick = stretch.first_tick + done + n
            end = int(np.searchsorted(rows[:, 0], last_tick))
            if end > QUEUE_ROWS:
                n = 1
                end = int(np.searchsorted(rows[:, 0], stretch.first_tick + done + 1))
            if not self.image.push_timed_table(np.ascontiguousarray(rows[:end])):
                raise LogError(f"tick {stretch.first_tick + done} has too many rows")
            rows = rows[end:]
            await self._core.scheduler.advance(n)
            frames = read_frames(self.image, number, n)
            # simulated, not planned, time
            frames.words[:, 1] = frames.ticks * period_ns
            yield Segmented(frames, np.full(n, stretch.segment, dtype=np.int64), posted)
            number += n
            done += n


class Comparison:
    """Counts equal ticks and remembers the first difference."""

    def __init__(self, log: Log, table: SignalTable, base_period_ns: int) -> None:
        outputs = [
            s
            for s in table.scalars
            if s.direction is Direction.OUT and s.name in log.columns
        ]
        self._names = [s.name for s in outputs]
        self._slots = np.array([s.slots[0] for s in outputs], dtype=np.intp)
        self._log = log
        self._ticks = log.ticks(base_period_ns)
        self._starts = {
            int(s): int(np.argmax(log.segment == s)) for s in np.unique(log.segment)
        }
        self.n_signals = len(outputs)
        self.n_ticks = 0
        self.difference: str | None = None

    def add(self, batch: Segmented) -> None:
        """Compare frames with the rows of the same segment and tick."""
        if not self.n_signals or self.difference is not None:
            return
        segment = int(batch.segments[0])
        ticks = batch.frames.ticks
        start = self._starts[segment]
        end = start + int((self._log.segment == segment).sum())
        rows = start + np.searchsorted(self._ticks[start:end], ticks)
        values = batch.frames.values[:, self._slots]
        values[(batch.frames.status[:, self._slots] & BAD) != 0] = np.nan
        for index, name in enumerate(self._names):
            recorded = self._log.columns[name][rows]
            ours = values[:, index].copy()
            is_equal_bit_for_bit = recorded.view(np.int64) == ours.view(np.int64)
            both_nan = np.isnan(recorded) & np.isnan(ours)
            equal = is_equal_bit_for_bit | both_nan
            if not equal.all():
                at = int(np.argmin(equal))
                was = float(recorded[at])
                now = float(ours[at])
                self.difference = (
                    f"{name} in tick {ticks[at]} of segment {segment}: recorded"
                    f" {was!r}, replayed {now!r}"
                )
                return
        self.n_ticks += len(ticks)

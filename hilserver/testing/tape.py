"""The newest ticks of a test, with all that a replay needs: inputs, states, parameters, faults."""

from collections import deque
from collections.abc import Mapping
from contextlib import closing, suppress
from pathlib import Path
from typing import Any, Final

from hilserver.daemon.daemon import Daemon
from hilserver.errors import ControlRefused
from hilserver.io.recorder.source import FrameSource
from hilserver.logs import RecordedState, Segmented, open_writer
from hilserver.logs.provenance import make_run

KEPT_FRAMES: Final = 60_000
STATE_EVERY: Final = 10_000
"""Frames from one state to the next: so much at the beginning is lost in a longer test."""
MANY_FRAMES: Final = 256
MOST_COMMANDS: Final = 4000


class Tape:
    """Keeps what a recorder of the daemon would write, until a test fails."""

    def __init__(self, daemon: Daemon) -> None:
        self._daemon = daemon
        self._source = FrameSource(daemon.image.name, is_inside=True)
        self._batches: deque[Segmented] = deque()
        self._n_frames = self._n_taken = self._since_state = 0
        self._many = min(MANY_FRAMES, daemon.image.control.ring_length // 4)
        first = self._source.first_state()
        self._states: deque[RecordedState] = deque([] if first is None else [first])
        # commands, and the number of the first frame in which each acts
        self._commands: deque[tuple[int, Mapping[str, Any]]] = deque(
            maxlen=MOST_COMMANDS
        )
        daemon.faults.watchers.append(self._note)

    def _note(self, command: Mapping[str, Any]) -> None:
        self._commands.append((self._daemon.image.head, command))

    @property
    def lost(self) -> int:
        """Frames that the ring had overwritten before they were taken."""
        return self._source.lost

    def take(self) -> None:
        """Take the new frames, and let the oldest ones go."""
        while (batch := self._source.frames()) is not None:
            self._batches.append(batch)
            self._n_taken = batch.frames.first + len(batch.frames)
            self._n_frames += len(batch.frames)
            self._since_state += len(batch.frames)
        if (state := self._source.state()) is not None:
            self._states.append(state)
            self._since_state = 0
        while self._n_frames > KEPT_FRAMES:
            self._n_frames -= len(self._batches.popleft().frames)

    async def keep_up(self) -> None:
        """Take the new frames if there are many, and save a state if the last one is old."""
        if self._daemon.image.head - self._n_taken < self._many:
            return
        self.take()
        if self._since_state >= STATE_EVERY:
            with suppress(ControlRefused):  # the plant is busy, or has ended
                await self._daemon.core.snapshots.capture()
            self.take()

    def write(self, path: Path) -> None:
        """Write a recording that can be replayed."""
        self.take()
        run = make_run(self._daemon.image.description) | {"faults": self._faults()}
        newest = self._batches[-1].frames.planned_ns[-1] if self._batches else 0
        utc_ns = self._daemon.clock.utc_ns(int(newest)) - int(newest)
        slots = range(len(run["signals"]))
        with closing(open_writer(path, run, slots, utc_ns)) as writer:
            for state in self._states:
                writer.add_state(state)
            for batch in self._batches:
                writer.write(batch)

    def _faults(self) -> list[dict[str, Any]]:
        """Return the commands to inject or end faults, each with segment and tick."""
        oldest = self._batches[0].frames.first if self._batches else 0
        # What was commanded before the oldest frame is in the state that a replay begins with.
        waiting = deque(c for c in self._commands if c[0] >= oldest)
        found = []
        for batch in self._batches:
            first, after = batch.frames.first, batch.frames.first + len(batch.frames)
            while waiting and waiting[0][0] < after:
                number, command = waiting.popleft()
                row = max(number - first, 0)
                segment, tick = batch.segments[row], batch.frames.ticks[row]
                found.append({"segment": int(segment), "tick": int(tick), **command})
        return found

    def close(self) -> None:
        """Let go of the image."""
        self._source.close()

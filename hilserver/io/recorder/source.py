"""Input of the recorder: every frame once, the states, and whether the daemon still runs."""

import fcntl
import json
import os
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilserver.errors import FailedError
from hilserver.image import FrameBatch, ImageReader, read_frames
from hilserver.image.changes import Changes
from hilserver.image.layout import REQUEST_SAVE
from hilserver.image.shared_file import path_of
from hilserver.image.state_request import (
    ShadowReader,
    ask_for_state,
    live_state,
    take_request,
)
from hilserver.io.recorder.marks import Mark
from hilserver.logs.log import Change, RecordedState
from hilserver.logs.writer import Segmented

BATCH_FRAMES = 256
_MARGIN_FRAMES = 64
_DESCRIBED_WITHIN_S = 5.0


class FrameSource:
    """The process image of one daemon, for a recorder.

    FailedError if no daemon runs under that name.
    """

    def __init__(self, name: str, *, is_inside: bool = False) -> None:
        self._name = name
        self._reader = ImageReader.attach(name)
        self._fd = os.open(path_of(name), os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
        if self.daemon_is_gone():
            self.close()
            raise FailedError(
                f"the daemon of the process image '{name}' is no longer running"
            )
        self.description = self._describe()
        self._ring_length = self._reader.control.ring_length
        self._shadow = ShadowReader(self._reader)
        # makes simulated time wait; None in real time, which cannot wait
        self.mark = Mark(name) if self._is_simulated and not is_inside else None
        self._next = max(0, self._reader.head)
        self._last_tick: int | None = None
        self._segment = 0
        self._changes = Changes(self._reader)
        if not self._reader.head:
            self._edition = self._reader.region("edition")[0][0]
        else:
            self._edition = None
        slots = (
            signal["slots"]
            for signal in self.description["signals"]
            if signal["name"] == "internal.edition"
        )
        self._edition_slot = int(next(slots)[0])
        self._start_without_state: tuple[int, int] | None = None
        self._gap = False
        self.lost = 0  # frames that were overwritten before they were read

    def _describe(self) -> dict[str, Any]:
        deadline = time.monotonic() + _DESCRIBED_WITHIN_S
        while True:
            try:
                return self._reader.description
            except ValueError:  # being written
                if time.monotonic() > deadline:
                    raise FailedError(
                        f"the process image '{self._name}' has no readable description"
                    ) from None
                time.sleep(0.01)

    @property
    def _is_simulated(self) -> bool:
        configuration = self.description["run"].get("configuration") or {}
        return bool(configuration.get("scheduler", {}).get("backend") == "virtual")

    def refresh(self) -> bool:
        """Read the description again; return whether it has changed (the audit is added late)."""
        try:
            new = self._reader.description
        except (ValueError, json.JSONDecodeError):
            return False
        changed = bool(new != self.description)
        self.description = new
        return changed

    def first_state(self) -> RecordedState | None:
        """Return the state before the first tick; None if ticks have run already."""
        words = live_state(self._reader)
        return None if words is None else RecordedState(0, 0, words)

    def ask_for_state(self) -> None:
        """Ask the daemon to copy its state; `state` returns it some milliseconds later."""
        ask_for_state(self._name)

    def frames(self) -> Segmented | None:
        """Return the next frames, None if there is none yet; earlier ones may be overwritten."""
        if self.mark is not None:
            self.mark.move(self._next)
        head = self._reader.head
        if head - self._next > self._ring_length - _MARGIN_FRAMES:
            self._skip_to(head - self._ring_length + 2 * _MARGIN_FRAMES)
        batch = read_frames(self._reader, self._next, BATCH_FRAMES)
        if not len(batch):
            if self._next < head:
                self._skip_to(self._next + _MARGIN_FRAMES)
            return None
        after_gap = self._last_tick is None or self._gap
        self._gap = False
        self._next += len(batch)
        return self._segmented(batch, after_gap=after_gap)

    def begin(self) -> None:
        """Begin with the next frame: those from before the file was ready are not recorded."""
        # triggers the compilation
        read_frames(self._reader, max(0, self._reader.head - 1), 1)
        if self.mark is None:
            self._next = max(0, self._reader.head)

    def _skip_to(self, number: int) -> None:
        self.lost += number - self._next
        self._next = number
        self._gap = True

    def _segmented(self, batch: FrameBatch, *, after_gap: bool) -> Segmented:
        """Begin a new segment where ticks are not consecutive although no frame is missing.

        Also begin one where parameters differ without a recorded change: a state was restored.
        """
        ticks = batch.ticks
        before = ticks[0] - 1 if self._last_tick is None else self._last_tick
        jumps = np.diff(ticks, prepend=before) != 1
        if after_gap and ticks[0] > before:
            jumps[0] = False
        editions = batch.values[:, self._edition_slot]
        last_edition = editions[0] if self._edition is None else self._edition
        changed = np.flatnonzero(np.diff(editions, prepend=last_edition) != 0).tolist()
        found = {
            at: self._changes.find(int(editions[at]), int(ticks[at])) for at in changed
        }
        jumps[[at for at, packed in found.items() if packed is None]] = True
        segments = self._segment + np.cumsum(jumps)
        changes = [
            Change(
                int(segments[at]),
                int(ticks[at]),
                int(editions[at]),
                self._named(packed),
                packed,
            )
            for at, packed in found.items()
            if packed is not None
        ]
        if jumps.any():
            last = int(np.flatnonzero(jumps)[-1])
            self._start_without_state = (int(segments[last]), int(ticks[last]))
        self._segment = int(segments[-1])
        self._last_tick = int(ticks[-1])
        self._edition = float(editions[-1])
        return Segmented(batch, segments, changes)

    def _named(self, packed: NDArray[np.float64]) -> dict[str, float]:
        """Return the values of a change by name."""
        regions = self.description["regions"]
        names = self.description["run"]["parameters"]
        first = regions["parameters"][0] - regions["p"][0]
        numbers = packed[first : first + len(names)].tolist()
        return dict(zip(names, numbers, strict=True))

    def state(self) -> RecordedState | None:
        """Return the newest state that was saved or restored, None if there is no new one."""
        taken = self._shadow.take()
        if taken is None:
            return None
        kind, tick, words = taken
        segment = self._segment
        if kind != REQUEST_SAVE:
            start = self._start_without_state
            self._start_without_state = None
            if start is not None and start[1] == tick:
                segment = start[0]
            else:
                segment = segment + 1
        return RecordedState(segment, tick, words)

    def daemon_is_gone(self) -> bool:
        """Return whether the daemon has removed its image, or lost the lock by dying."""
        if os.fstat(self._fd).st_nlink == 0:
            return True
        try:
            fcntl.flock(self._fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            return False
        fcntl.flock(self._fd, fcntl.LOCK_UN)
        return True

    def release_time(self) -> None:
        """Let simulated time wait no longer."""
        if self.mark is not None:
            self.mark.close()
            self.mark = None

    def close(self) -> None:
        """Release the image, and a request that was not answered."""
        take_request(self._name)
        self.release_time()
        os.close(self._fd)

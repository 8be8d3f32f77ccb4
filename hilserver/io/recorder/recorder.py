"""Reads every frame of the process image and hands it to the writing thread."""

import fnmatch
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from hilserver.errors import FailedError, reason
from hilserver.io.recorder.series import FileSeries, Settings
from hilserver.io.recorder.source import FrameSource
from hilserver.io.recorder.thinning import Thinner
from hilserver.io.recorder.write_behind import NextFile, WriteBehind
from hilserver.logs.provenance import make_run
from hilserver.logs.writer import size_of
from hilserver.logs.writing import check_suffix

POLL_S = 0.02
POLL_SIMULATED_S = 0.002
SUPERVISE_S = 0.25
SAY_AGAIN_S = 5.0
STATE_WITHIN_S = 2.0
CLOSE_WITHIN_S = 30.0
GROWTH_AFTER_S = 10.0
"""From then on, how fast a recording grows is worth saying."""


class Recorder:
    """Records the image `name` until it is stopped or the daemon has ended.

    FailedError if there is no such daemon, no such signal, or the file cannot be made.
    """

    def __init__(self, name: str, settings: Settings) -> None:
        if settings.bag is None:
            check_suffix(settings.path)
        self.stop = threading.Event()
        self._source = FrameSource(name, is_inside=settings.waits)
        self._waits = settings.waits or self._source.mark is not None
        self._run = make_run(self._source.description)
        self._slots = self._choose(settings.signals)
        self._utc_ns = time.time_ns() - time.monotonic_ns()
        self._series = FileSeries(settings)
        try:
            self._writing = WriteBehind(
                lambda: self._series.open(self._run, self._slots, self._utc_ns),
                self._series.is_full,
                self._want_state,
                settings.buffer_bytes,
                self._series.check,
            )
        except TimeoutError as error:
            raise FailedError(
                f"{settings.path}: {error}; see whether its disk answers"
            ) from None
        self._rotate_s = settings.rotate_s
        self._file_began = 0
        self._period_s = int(self._run["base_period_ns"]) * 1e-9
        self._thinner = Thinner(self._slots) if settings.sparse else None
        self._asked_s: float | None = None
        self._reported = (0, 0)
        self._next_s = 0.0
        self._reported_s = 0.0
        self._rotates = (
            settings.rotate_s is not None or settings.rotate_bytes is not None
        )
        self._seen = 0  # frames of the daemon
        self._source.begin()
        first = self._source.first_state()
        if first is None:
            self._want_state()
        else:
            self._writing.put(first)

    def _choose(self, patterns: Sequence[str]) -> list[int]:
        names = [signal["name"] for signal in self._run["signals"]]
        for pattern in patterns:
            if not fnmatch.filter(names, pattern):
                raise FailedError(
                    f"no signal matches '{pattern}'; see 'hilserver signals' for the names"
                )
        return [
            slot
            for slot, name in enumerate(names)
            if any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns)
        ]

    @property
    def path(self) -> Path:
        """File that is being written."""
        return self._series.current

    @property
    def lacks_inputs(self) -> bool:
        """Whether inputs are left out, so that no replay is possible."""
        inputs = {
            i for i, s in enumerate(self._run["signals"]) if s["direction"] == "in"
        }
        return not inputs <= set(self._slots)

    def run(self, duration_s: float | None) -> str:
        """Record; return one line about the recording.

        FailedError if the disk is full or the file can no longer be written.
        """
        end_s = None if duration_s is None else time.monotonic() + duration_s
        next_s = time.monotonic()
        is_growth_said = False
        while not self.stop.is_set() and self._writing.error is None:
            now_s = time.monotonic()
            gone = False
            if now_s >= next_s:
                # read before the last look at the ring
                gone = self._source.daemon_is_gone()
                self._supervise(now_s)
                next_s = now_s + SUPERVISE_S
            self._read()
            if not is_growth_said and (growth := self._growth(self._writing.n_bytes)):
                is_growth_said = True
                print(f"{self.path} grows by {growth}", file=sys.stderr, flush=True)
            if gone or (end_s is not None and now_s >= end_s):
                break
            self.stop.wait(POLL_SIMULATED_S if self._waits else POLL_S)
        self._read()
        return self._close()

    @property
    def why_ended(self) -> str:
        """Why nothing more can be written; empty while it can."""
        error = self._writing.error
        if isinstance(error, OSError):
            return f"{self.path}: recording ended: {reason(error)}"
        return str(error) if error is not None else ""

    def look(self) -> None:
        """Take new frames, between two batches of simulated time; none once writing has failed."""
        now_s = time.monotonic()
        if self._writing.error is None:
            self._read()
            if now_s >= self._next_s:
                self._supervise(now_s)
                self._next_s = now_s + SUPERVISE_S

    def close(self) -> str:
        """Complete the file; return one line about the recording.

        FailedError if the disk is full or the file can no longer be written.
        """
        if self._writing.error is None:
            self._read()
        return self._close()

    def _read(self) -> None:
        if (state := self._source.state()) is not None:
            self._asked_s = None
            self._writing.put(state)
        dropped = False
        while (batch := self._source.frames()) is not None:
            # Begin the next file when the present one is long enough.
            first = int(batch.frames.ticks[0])
            last = int(batch.frames.ticks[-1])
            began = self._file_began
            if not 0 < began <= first:  # the first batch, or time has gone back
                self._file_began = first
            elif (
                self._rotate_s is not None
                and (last - began) * self._period_s >= self._rotate_s
            ):
                self._file_began = first
                self._writing.put(NextFile())
            self._seen += len(batch.frames)
            if self._thinner is not None:
                batch = self._thinner.thinned(batch)
            dropped |= len(batch.frames) > 0 and not self._writing.put(
                batch, wait=self._waits
            )
        if dropped or self._source.lost > self._reported[0]:
            self._want_state()

    def _want_state(self) -> None:
        if self._asked_s is None:
            self._asked_s = time.monotonic()
            self._source.ask_for_state()

    def _supervise(self, now_s: float) -> None:
        if self._source.refresh():
            # later ones are changes in the file
            began_with = {"patch": self._run.get("patch")}
            self._run = make_run(self._source.description) | began_with
            self._writing.put(self._run)
        if self._asked_s is not None and now_s - self._asked_s > STATE_WITHIN_S:
            self._asked_s = now_s
            self._source.ask_for_state()
        counts = (self._source.lost, self._writing.dropped)
        if counts != self._reported and now_s - self._reported_s > SAY_AGAIN_S:
            self._reported = counts
            self._reported_s = now_s
            text = f"{_losses(*counts)} so far"
            print(f"hilserver: {text}", file=sys.stderr, flush=True)

    def _growth(self, n_bytes: int) -> str:
        """Return how fast the file grows; empty while there is too little of it to say."""
        seconds = self._seen * self._period_s
        if seconds < GROWTH_AFTER_S or self._rotates:
            return ""
        return f"{n_bytes / seconds * 3600e-9:.2g} GB per hour"

    def _close(self) -> str:
        self._source.release_time()
        in_time = self._writing.close(CLOSE_WITHIN_S)
        self._source.close()
        error = self._writing.error
        growth = self._growth(size_of(self.path))
        counts = f"{self._writing.written} frames in {self.path}"
        counts += f", {growth}" if growth else ""
        if isinstance(error, OSError):
            raise FailedError(self.why_ended)
        if error is not None:
            raise error
        if not in_time:
            raise FailedError(
                f"{self.path}: the disk did not accept the rest within {CLOSE_WITHIN_S:g} s;"
                f" {counts}"
            )
        return f"recorded {counts}; {_losses(self._source.lost, self._writing.dropped)}"


def _losses(lost: int, dropped: int) -> str:
    if not lost and not dropped:
        return "none lost"
    return f"{lost} frames lost (read too late), {dropped} dropped (disk too slow)"

"""Takes every frame from the ring, for captures."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from hilserver.config.loading import checked
from hilserver.image import Frame, ImageReader
from hilserver.requirements import Drive, Judge, Requirement
from hilserver.signals import Signal, SignalTable
from hilserver.testing.series import Series

__tracebackhide__ = True  # pytest then shows the failing line of the test
MAX_NUMBERS = 20_000_000


class Judged(NamedTuple):
    """Which requirements a test judged last, and on which part of its drive."""

    requirements: list[dict[str, Any]]
    from_s: float  # time of the first sample
    to_s: float  # and of the last


class Tap:
    """Drains the ring of frames; nothing waits for it, missed frames are counted."""

    def __init__(self, image: ImageReader) -> None:
        self._image = image
        self._next = image.head
        self.lost = 0  # frames that the ring had overwritten
        self.captures: list[Capture] = []
        self.judged: Judged | None = None

    def drain(self) -> list[Frame]:
        """Take the new frames; return them."""
        frames: list[Frame] = []
        head = self._image.head
        for number in range(self._next, head):
            frame = self._image.frame(number)
            if frame is None:
                self.lost += 1
                continue
            frames.append(frame)
            for capture in self.captures:
                capture.add(frame)
        self._next = head
        return frames


class Capture(Mapping[str, Series]):
    """Signals recorded while the ``async with`` block runs; a mapping from name to `Series`."""

    def __init__(
        self, tap: Tap, table: SignalTable, signals: Iterable[Signal], period_s: float
    ):
        self._tap = tap
        self._table = table
        self._signals = list(signals)
        self._slots = [slot for signal in self._signals for slot in signal.slots]
        self._period_s = period_s
        self._ticks: list[int] = []
        self._rows: list[NDArray[np.float64]] = []
        self._lost_before = 0

    async def __aenter__(self) -> Self:
        self._tap.drain()
        self._lost_before = self._tap.lost
        self._tap.captures.append(self)
        return self

    async def __aexit__(self, _kind: object, error: object, _trace: object) -> None:
        self._tap.drain()
        self._tap.captures.remove(self)
        lost = self._tap.lost - self._lost_before
        if lost and error is None:
            raise AssertionError(
                f"{lost} frames were not captured: the test kept the event loop busy for longer"
                " than the ring holds; raise image.ring_frames"
            )

    def add(self, frame: Frame) -> None:
        """Take one frame."""
        if len(self._rows) * len(self._slots) > MAX_NUMBERS:
            raise AssertionError(
                f"a capture holds {MAX_NUMBERS} numbers at most; capture fewer signals or less time"
            )
        self._ticks.append(frame.tick)
        self._rows.append(frame.values[self._slots])

    @property
    def tick(self) -> NDArray[np.int64]:
        """Tick of every sample, shape (n,)."""
        return np.array(self._ticks, dtype=np.int64)

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Simulated time of every sample [s], shape (n,)."""
        return self.tick.astype(np.float64) * self._period_s

    def margins(
        self, *requirements: Requirement | Mapping[str, Any]
    ) -> dict[str, float]:
        """Return the margin of every requirement by its name; times count from the first sample.

        Parameters
        ----------
        *requirements : Requirement or mapping
            As in a sweep: ``{"name": "arrives", "signal": "pose.x_m", "above": 4.9}``.
        """
        found = [
            r
            if isinstance(r, Requirement)
            else checked(Requirement, r, "requirement: ")
            for r in requirements
        ]
        if not found:
            raise AssertionError(
                "there is nothing to judge: give a requirement, as {'name': ..., 'signal': ...,"
                " 'above': 4.9}"
            )
        judge = Judge(found, self._table)
        missing = [name for name in judge.signals if name not in list(self)]
        if missing:
            raise AssertionError(
                f"'{missing[0]}' was not captured; capture all that is required"
            )
        length_s = (len(self._rows) - 1) * self._period_s
        for requirement in found:
            until_s = requirement.lasts_s
            if (
                requirement.always
            ):  # else it is met at the latest when it has become true once
                until_s = max(until_s, requirement.within_s or 0.0)
            if until_s > length_s + self._period_s:
                raise AssertionError(
                    f"'{requirement.name}' is about {until_s:g} s, and the capture is"
                    f" {max(length_s, 0.0):g} s long; step further inside the capture"
                )
        if not any(
            requirement.python for requirement in found
        ):  # a function is no text
            texts = [r.model_dump(mode="json", exclude_defaults=True) for r in found]
            span_s = self.time_s[[0, -1]].tolist()
            self._tap.judged = Judged(texts, *span_s)
        columns = {name: self[name].values for name in judge.signals}
        return judge.margins(Drive(self._period_s, columns))

    def assert_meets(self, *requirements: Requirement | Mapping[str, Any]) -> None:
        """Fail if a requirement is not met; parameters as for `margins`."""
        margins = self.margins(*requirements)
        failed = [
            f"{name} (margin {m:g})" for name, m in margins.items() if not m >= 0.0
        ]
        if failed:
            raise AssertionError(f"requirements are not met: {', '.join(failed)}")

    def __getitem__(self, name: str) -> Series:
        signal = self._table[name]
        if signal.is_array or signal.slots[0] not in self._slots:
            raise KeyError(
                f"'{name}' was not captured as a scalar; captured are {list(self)}"
            )
        column = self._slots.index(signal.slots[0])
        values = np.array([row[column] for row in self._rows])
        return Series(name, signal.unit, self.time_s, self.tick, values)

    def __iter__(self) -> Iterator[str]:
        return (self._table.by_slot(slot).name for slot in self._slots)

    def __len__(self) -> int:
        return len(self._slots)

"""Reset alone moves nothing: hands have to be at rest first, automatic sources wait for Start.

A hand is at rest by a command whose set-points are all zero, or, where it sends nothing at rest, by
silence. A controller cannot let go, so a person has to call Start. What a source sends before is
refused, so that a recording holds only what has acted.
"""

from collections.abc import Collection
from typing import Final

from hilserver.core.leases import FOXGLOVE, TELEOP, kind_of
from hilserver.image import ProcessImage, Row
from hilserver.signals import AUTOMATIC, SignalTable

WAITS: Final = "control.waits_for_start"

SILENT_AT_REST = frozenset({FOXGLOVE})
SILENT_NS = 1_000_000_000


class Rest:
    """Which hands have been at rest since commands were ended last."""

    def __init__(self) -> None:
        self._ended_ns = 0  # 0: never
        self._rested: set[str] = set()
        self._heard_ns: dict[str, int] = {}

    def end(self, now_ns: int) -> None:
        """Note that commands were ended: every hand has to be at rest again."""
        self._ended_ns = now_ns
        self._rested.clear()

    def lets_move(self, source: str, setpoints: Collection[float], now_ns: int) -> bool:
        """Whether a command of a hand may act; notes if the hand is at rest by it."""
        heard_ns = max(self._heard_ns.get(source, 0), self._ended_ns)
        if source in SILENT_AT_REST:
            self._heard_ns[source] = now_ns
            if now_ns - heard_ns > SILENT_NS:
                self._rested.add(source)
        if not any(setpoints):
            self._rested.add(source)
        return not self._ended_ns or source in self._rested


def is_hand(source: str) -> bool:
    """Whether a person drives by this source: the page, a terminal, Foxglove."""
    return kind_of(source) == "page" or is_terminal(source)


def is_terminal(source: str) -> bool:
    """Whether it is a teleoperation in a terminal; each has a number: ``opcua:teleop:1``."""
    return source.startswith(TELEOP)


class Interlock:
    """Automatic sources wait for Start once a safe state was acknowledged (ISO 13850).

    A signal shows it and, as an input of the plant, is part of recordings and snapshots.

    Parameters
    ----------
    must_wait : bool
        False: automatic sources drive on after Reset.

    Attributes
    ----------
    waits : bool
        Whether they wait now.
    """

    def __init__(
        self, table: SignalTable, image: ProcessImage, *, must_wait: bool
    ) -> None:
        self.must_wait = must_wait
        self.waits = False
        self._image = image
        self._slot = table.slot(WAITS)

    def holds(self, kind: str) -> bool:
        """Whether sources of this kind wait now; their leases must not run meanwhile."""
        return self.waits and kind in AUTOMATIC

    def engage(self) -> None:
        """Note that a safe state was acknowledged."""
        self._set(self.must_wait)

    def release(self) -> None:
        """Note that a person has called Start."""
        self._set(False)

    def adopt(self) -> None:
        """Take over a restored state: one that waited waits again, and none ends a wait."""
        # a frame comes first; 0 is 0 in any type
        in_state = bool(self._image.shadow[self._slot])
        self._set(self.waits or (self.must_wait and in_state))

    def show(self) -> None:
        """Write the signal again if it differs: the queue may have been full."""
        if self._image.frame_values[self._slot] != self.waits:
            self._set(self.waits)

    def _set(self, waits: bool) -> None:
        self.waits = waits
        self._image.push([Row(self._slot, float(waits))])

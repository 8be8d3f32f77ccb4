"""Hands have to be at rest first: a stick that is still held must not drive again after a Reset.

A hand is at rest by a command whose set-points are all zero, or, where it sends nothing at rest, by
silence. What it sends before is refused, so that a recording holds only what has acted.
"""

from collections.abc import Collection

from hilserver.core.leases import FOXGLOVE, TELEOP, kind_of

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

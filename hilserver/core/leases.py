"""The leases of a robot as Python sees them: who may hold one, for how long, which have lapsed."""

from collections.abc import Iterator
from typing import NamedTuple

from hilserver.image import ProcessImage, Row, leases
from hilserver.image.status import GOOD
from hilserver.plant.layout import N_COMMANDS, N_SETPOINTS
from hilserver.signals import SOURCES

NOBODY, TELEOP = "nobody", "opcua:teleop"
OFFERING = frozenset(SOURCES[leases.FIRST_OFFERING :])
"""Kinds that say what they want whether or not they have control."""
_ACTIONS = {number: action for action, number in leases.POLICIES.items()}


class Lapse(NamedTuple):
    """A source that drives has not renewed its command in time.

    Attributes
    ----------
    action : str
        What the step has done: hold, zero, ramp or device.
    limit_ms : float
        What it was given.
    stalled_ticks : int
        How long the daemon's event loop had not been heard by then.
    """

    source: str
    action: str
    limit_ms: float
    stalled_ticks: int


class Leases:
    """Places in the image's region for sources, by name; a kind of sources shares a row.

    Parameters
    ----------
    ramp_ticks : int
        In which the set-points go to zero when control changes hands, and in the safe state.
    """

    def __init__(self, image: ProcessImage, ramp_ticks: int = 0) -> None:
        self._image, self._base = image, image.layout.regions[leases.REGION].base
        self._words = image.words[self._base :]
        self._entries: dict[str, int] = {}
        self._known: dict[str, int] = {}
        image.control.setpoint_slots = N_SETPOINTS
        image.control.leases = self._base
        self._words[leases.RAMP] = image.control.safe_ramp = ramp_ticks
        for kind in range(leases.KINDS):
            image.values[self._base + leases.VALUES + kind * leases.ROW + N_COMMANDS - 1] = 1.0

    def add(self, source: str, limit_ms: float | None, action: str) -> None:
        """Give `source` a lease; what it commands lapses after `limit_ms`, None: never."""
        entry = leases.FIRST_ENTRY + len(self._entries) * leases.ENTRY
        self._entries[source] = entry
        self._words[entry + leases.KIND] = SOURCES.index(source.partition(":")[0])
        self._words[entry + leases.POLICY] = leases.POLICIES[action]
        self._words[leases.COUNT] = len(self._entries)
        self.limit(source, limit_ms)

    def limit(self, source: str, limit_ms: float | None) -> None:
        """Change how long a command of `source` holds."""
        limit_ns = 0 if limit_ms is None else max(1, round(limit_ms * 1e6))
        self._words[self._entries[source] + leases.LIMIT] = limit_ns

    def limit_ms(self, source: str) -> float | None:
        """Return how long a command of `source` holds, None for ever."""
        limit_ns = int(self._words[self._entries[source] + leases.LIMIT])
        return limit_ns / 1e6 if limit_ns else None

    def begin(self, kind: str) -> None:
        """Let the sources of `kind` have control, before the first tick."""
        self._image.values[self._base + leases.OWNER] = self._number(kind)

    def place(self, kind: str, slot: int) -> int:
        """Return where a value of this kind of source for `slot` is to be pushed."""
        if slot >= N_COMMANDS:
            return slot
        return self._slot(leases.VALUES + self._number(kind) * leases.ROW + slot)

    def renewal(self, source: str) -> list[Row]:
        """Return the row that renews what `source` holds; none if that never lapses."""
        entry = self._entries.get(source) or self._entries.get(source.partition(":")[0])
        return [] if entry is None else [Row(self._slot(entry + leases.RENEWED), 1.0)]

    def hand_over(self, kind: str) -> Row:
        """Return the row that gives control to the sources of `kind`."""
        return Row(self._slot(leases.OWNER), self._number(kind), GOOD)

    def end(self) -> Row:
        """Return the row that ends every lease."""
        return Row(self._slot(leases.END), 1.0, GOOD)

    def lapses(self) -> Iterator[Lapse]:
        """Yield those that have changed what is driven, each once."""
        words = self._words
        for source, entry in self._entries.items():
            lapses = int(words[entry + leases.LAPSES])
            before, self._known[source] = self._known.get(source, 0), lapses
            if lapses != before:
                action = _ACTIONS[int(words[entry + leases.POLICY])]
                limit_ms = self.limit_ms(source) or 0.0
                yield Lapse(source, action, limit_ms, int(words[entry + leases.STALLED]))

    def has_lapsed(self, source: str) -> bool:
        """Whether `source` has not renewed yet what lapsed."""
        return bool(self._words[self._entries[source] + leases.LAPSED])

    def _slot(self, index: int) -> int:
        return self._image.n_slots + index

    @staticmethod
    def _number(kind: str) -> int:
        return leases.NO_KIND if kind == NOBODY else SOURCES.index(kind)

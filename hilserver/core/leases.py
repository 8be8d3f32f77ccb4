"""The leases of a robot, for Python: who may hold one, for how long, which have lapsed."""

import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

from hilserver.image import ProcessImage, Row, leases
from hilserver.image.leases import Driving, Lease
from hilserver.plant.layout import N_COMMANDS, N_SETPOINTS
from hilserver.signals import SOURCES
from hilserver.status import GOOD

NOBODY, TELEOP, FOXGLOVE = "nobody", "opcua:teleop", "page:foxglove"
OFFERING = frozenset(SOURCES[leases.FIRST_OFFERING :])
"""Kinds that send their commands whether or not they have control."""
_ACTIONS = {number: action for action, number in leases.POLICIES.items()}


def kind_of(source: str) -> str:
    """Return the kind of a source: ``peer:iot2050`` is a ``peer``."""
    return source.partition(":")[0]


class Lapse(NamedTuple):
    """A source that drives has not renewed its command in time."""

    source: str
    action: str  # what the step has done: hold, zero, ramp or device
    limit_ms: float  # of the lease
    stalled_ticks: int  # for which the event loop of the daemon had stood still
    waited_ms: float  # for which its last command had waited to be read


class Leases:
    """Places of sources in the image's region, by name; sources of one kind share a row.

    Parameters
    ----------
    ramp_ticks : int
        Length of the ramp to zero when control changes hands, and in the safe state.
    monotonic_ns : callable
        Clock for the age of commands; it stands where time is simulated.
    """

    def __init__(
        self,
        image: ProcessImage,
        ramp_ticks: int = 0,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.now_ns = monotonic_ns
        self._image = image
        base = image.layout.regions[leases.REGION].base
        self._words = image.words[base:]
        self._driving = Driving.of(self._words)
        self._places: dict[str, int] = {}
        self._known: dict[str, int] = {}
        image.control.setpoint_slots = N_SETPOINTS
        image.control.leases = base
        self._driving.ramp = image.control.safe_ramp = ramp_ticks
        self._driving.values[:, N_COMMANDS - 1] = 1.0

    def add(self, source: str, limit_ms: float | None, action: str) -> None:
        """Give `source` a lease; its commands lapse after `limit_ms`, None: never."""
        self._places[source] = leases.words_needed(len(self._places))
        lease = self._lease(source)
        lease.kind = SOURCES.index(kind_of(source))
        lease.policy = leases.POLICIES[action]
        self._driving.count = len(self._places)
        self.limit(source, limit_ms)

    def limit(self, source: str, limit_ms: float | None) -> None:
        """Change how long a command of `source` holds."""
        if limit_ms is None:
            self._lease(source).limit = 0
        else:
            self._lease(source).limit = max(1, round(limit_ms * 1e6))

    def limit_ms(self, source: str) -> float | None:
        """Return how long a command of `source` holds, None if for ever."""
        limit_ns = int(self._lease(source).limit)
        return limit_ns / 1e6 if limit_ns else None

    def begin(self, kind: str) -> None:
        """Let the sources of `kind` have control, before the first tick."""
        self._driving.owner = self._number(kind)

    def place(self, kind: str, slot: int) -> int:
        """Return where a value of this kind of source for `slot` is to be pushed."""
        if slot >= N_COMMANDS:
            return slot
        row = leases.VALUES + self._number(kind) * leases.ROW
        return self._slot(row + slot)

    def renew(self, source: str, came_ns: int) -> None:
        """Renew the lease of `source`, which sent something at `came_ns`, but no command."""
        self._image.push(self.renewal(source, came_ns))

    def renewal(self, source: str, came_ns: int) -> list[Row]:
        """Return the row that renews the lease of `source` at `came_ns`, if it has one."""
        # Pages and terminals have a number each, and share a lease.
        shared = source.rpartition(":")[0]
        places = self._places
        place = places.get(source) or places.get(shared) or places.get(kind_of(source))
        age_ns = max(self.now_ns() - came_ns, 0)
        if place is None:
            return []
        return [Row(self._slot(place), float(age_ns))]

    def hand_over(self, kind: str) -> Row:
        """Return the row that gives control to the sources of `kind`."""
        return Row(self._slot(leases.OWNER), self._number(kind), GOOD)

    def end(self) -> Row:
        """Return the row that ends every lease."""
        return Row(self._slot(leases.END), 1.0, GOOD)

    def lapses(self) -> Iterator[Lapse]:
        """Yield the lapses that changed what is driven, each once."""
        for source in self._places:
            lease = self._lease(source)
            before = self._known.get(source, 0)
            self._known[source] = int(lease.lapses)
            if lease.lapses != before:
                limit_ms = self.limit_ms(source) or 0.0
                action = _ACTIONS[int(lease.policy)]
                waited_ms = lease.waited / 1e6
                yield Lapse(source, action, limit_ms, int(lease.stalled), waited_ms)

    def has_lapsed(self, source: str) -> bool:
        """Whether the lease of `source` has lapsed and is not renewed yet."""
        return bool(self._lease(source).lapsed)

    def _lease(self, source: str) -> Lease:
        return Lease.of(self._words, self._places[source])

    def _slot(self, index: int) -> int:
        return self._image.n_slots + index

    @staticmethod
    def _number(kind: str) -> int:
        return leases.NO_KIND if kind == NOBODY else SOURCES.index(kind)

"""What a signal is, and a table of them by name and by slot."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum

from hilserver.signals.vocabulary import MEASURED


class ValueType(StrEnum):
    """OPC UA built-in types that signals use."""

    DOUBLE = "Double"
    BOOLEAN = "Boolean"
    BYTE = "Byte"
    UINT32 = "UInt32"
    INT64 = "Int64"


class Direction(StrEnum):
    """Direction as seen from the plant."""

    IN = "in"
    OUT = "out"


@dataclass(frozen=True, slots=True)
class Signal:
    """One named quantity."""

    name: str  # dotted name that ends in its unit
    unit: str  # unit symbol ("rpm", "m/s", ...), "1" without a unit
    type: ValueType
    direction: Direction
    # engineering range; writes outside it are refused
    low: float
    high: float
    description: str
    # places in the frame: one for a scalar, those of its scalars for an array
    slots: tuple[int, ...]
    initial: float = 0.0
    # names of the values 0, 1, ... (of a Boolean: false, true), if they have names
    labels: tuple[str, ...] = ()
    # part of frame, log and snapshot, but not of any user interface
    hidden: bool = False
    is_own: bool = False  # an input that only the daemon itself writes

    @property
    def is_array(self) -> bool:
        """Whether the signal is an alias of several scalars."""
        return len(self.slots) > 1

    @property
    def range_text(self) -> str:
        """The range in words: ``-0.8 .. 0.8 m/s``, or the only value that this robot accepts."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        if self.low == self.high:
            return f"{self.low:g}{unit}, all that this robot's plant.drive can do"
        return f"{self.low:g} .. {self.high:g}{unit}"

    @property
    def writable(self) -> bool:
        """Whether a source may write it."""
        return self.direction is Direction.IN and not self.is_own

    @property
    def is_measured(self) -> bool:
        """Whether it is a value of the real robot, not of the simulation."""
        return self.name.startswith(MEASURED)


class SignalTable:
    """All signals of one robot by name and by slot; iteration leaves out hidden ones."""

    def __init__(self, signals: Iterable[Signal]) -> None:
        self._signals = tuple(signals)
        self._by_name = {signal.name: signal for signal in self._signals}
        self._by_slot = {s.slots[0]: s for s in self._signals if not s.is_array}
        if len(self._by_name) != len(self._signals):
            names = [signal.name for signal in self._signals]
            twice = next(name for name in names if names.count(name) > 1)
            raise ValueError(f"two signals have the name '{twice}'")
        if sorted(self._by_slot) != list(range(len(self._by_slot))):
            raise ValueError("the slots of the scalars are not 0 .. n-1")

    def __iter__(self) -> Iterator[Signal]:
        return (signal for signal in self._signals if not signal.hidden)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __getitem__(self, name: str) -> Signal:
        return self._by_name[name]

    def __contains__(self, name: object) -> bool:
        return name in self._by_name

    @property
    def n_slots(self) -> int:
        """Number of scalar places in a frame."""
        return len(self._by_slot)

    @property
    def scalars(self) -> tuple[Signal, ...]:
        """Every scalar, hidden ones included, in the order of the slots."""
        return tuple(self._by_slot[slot] for slot in range(self.n_slots))

    def by_slot(self, slot: int) -> Signal:
        """Return the scalar that occupies `slot`."""
        return self._by_slot[slot]

    def slot(self, name: str) -> int:
        """Return the slot of the scalar `name`."""
        return self._by_name[name].slots[0]

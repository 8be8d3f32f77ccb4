"""The values of all signals in the address space: one pass per frame, no work for unread ones.

A frame is taken over as it is, and every variable whose bits or status differ gets its stamp. The
DataValue itself is made when it is read or sampled, once per change.
"""

import math
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any, NamedTuple

import numpy as np
from asyncua import ua
from asyncua.server.address_space import AttributeValue

from hilserver.core.clock import UtcClock
from hilserver.image import Frame
from hilserver.io.opcua_server.model import DATA_TYPES
from hilserver.opcua.encoding import FixedDataValue
from hilserver.signals import Signal, SignalTable, ValueType

_CONVERT: dict[ValueType, Callable[[float], Any]] = {
    ValueType.DOUBLE: float,
    ValueType.BOOLEAN: bool,
    ValueType.BYTE: int,
    ValueType.UINT32: int,
    ValueType.INT64: int,
}
_NO_VALUE = ua.Variant()
_NEVER_WRITTEN = -1
_SEVERITY_SHIFT = 30
_BAD = 2


class Stamp(NamedTuple):
    """When a value was produced, and when it reached us."""

    source: datetime | None
    server: datetime


def worst(codes: list[int]) -> int:
    """Return the worst status code: bad before uncertain before good."""
    return max(codes, key=lambda code: (code >> _SEVERITY_SHIFT) & 3)


class SignalPlace(AttributeValue):  # type: ignore[misc]
    """Place of a signal's value in the address space; the value is made when it is read."""

    def __init__(
        self, signal: Signal, variables: "SignalVariables", stamp: Stamp
    ) -> None:
        self._signal = signal
        self._variables = variables
        self._kind = ua.VariantType(DATA_TYPES[signal.type])
        self._convert = _CONVERT[signal.type]
        self._made_of: Stamp | None = None
        self._made: FixedDataValue
        self.stamp = stamp  # that of the last change
        super().__init__(None)

    @property
    def value(self) -> FixedDataValue:
        """The value since the last change; the same object until the next."""
        if self._made_of is not self.stamp:
            self._made = self._make()
            self._made_of = self.stamp
        return self._made

    @value.setter
    def value(self, value: object) -> None:
        """Ignore writes: the value is always that of the frame."""

    def _make(self) -> FixedDataValue:
        slots = self._signal.slots
        code_of = self._variables.code
        values = self._variables.values
        status = self._variables.status
        if len(slots) == 1:
            code = status[slots[0]]
        else:
            code = worst([status[slot] for slot in slots])
        numbers = [values[slot] for slot in slots]
        if code < 0:
            code = int(ua.StatusCodes.BadWaitingForInitialData)
        elif code >> _SEVERITY_SHIFT < _BAD and not all(map(math.isfinite, numbers)):
            # A result that is not finite is no value, whatever status the model has set.
            code = int(ua.StatusCodes.BadSensorFailure)
        source, server = self.stamp
        if code >> _SEVERITY_SHIFT >= _BAD:
            return FixedDataValue(_NO_VALUE, code_of(code), source, server)
        if self._signal.is_array:
            array = [self._convert(number) for number in numbers]
            variant = ua.Variant(array, self._kind, None, True)
        else:
            variant = ua.Variant(self._convert(numbers[0]), self._kind, None, False)
        return FixedDataValue(variant, code_of(code), source, server)


class SignalVariables:
    """All variables that show signals.

    Notes
    -----
    A value changes when its bits or its status code differ from those before. What a client has
    just written is shown at once and kept until the first frame that contains it, so that a client
    reads what it wrote and no earlier frame restores the old value.
    """

    def __init__(self, table: SignalTable, clock: UtcClock) -> None:
        self._clock = clock
        started = Stamp(None, datetime.now(UTC))
        # signal name -> its place in the address space
        self.places = {
            signal.name: SignalPlace(signal, self, started) for signal in table
        }
        self._by_slot: list[list[SignalPlace]] = [[] for _ in range(table.n_slots)]
        for signal in table:
            for slot in signal.slots:
                self._by_slot[slot].append(self.places[signal.name])
        self._signals = {signal.name: signal for signal in table}
        self._values = np.zeros(table.n_slots)
        self._bits = self._values.view(np.int64)
        self._status = np.full(table.n_slots, _NEVER_WRITTEN, dtype=np.int64)
        self._held_until = np.zeros(table.n_slots, dtype=np.int64)
        self._is_any_held = False
        self._codes: dict[int, ua.StatusCode] = {}
        self.values: list[float] = self._values.tolist()
        self.status: list[int] = self._status.tolist()

    def publish(self, frame: Frame) -> int:
        """Take over what changed since the last frame; return the number of slots."""
        bits = frame.values.view(np.int64)
        changed = (bits != self._bits) | (frame.status != self._status)
        if self._is_any_held:
            # Which slots to write: held ones only on release, and then in any case
            held = self._held_until > frame.latched_rows
            released = (self._held_until > 0) & ~held
            self._held_until[released] = 0
            self._is_any_held = bool(held.any())
            changed = (changed | released) & ~held
        slots = np.flatnonzero(changed)
        if slots.size == 0:
            return 0
        self._bits[slots] = bits[slots]
        self._status[slots] = frame.status[slots]
        self._mark(slots.tolist(), self._clock.utc(frame.planned_ns))
        return int(slots.size)

    def show_written(
        self, values: Mapping[str, tuple[float, ...]], pushed_rows: int
    ) -> None:
        """Show accepted writes until a frame has latched `pushed_rows` rows."""
        slots: list[int] = []
        for name, numbers in values.items():
            for slot, number in zip(self._signals[name].slots, numbers, strict=True):
                self._values[slot] = number
                slots.append(slot)
        self._status[slots] = 0
        self._held_until[slots] = pushed_rows
        self._is_any_held = True
        self._mark(slots, datetime.now(UTC))

    def _mark(self, slots: list[int], source: datetime) -> None:
        stamp = Stamp(source, datetime.now(UTC))
        self.values, self.status = self._values.tolist(), self._status.tolist()
        for slot in slots:
            for place in self._by_slot[slot]:
                place.stamp = stamp

    def code(self, code: int) -> ua.StatusCode:
        """Return a status code; the same object for the same number."""
        found = self._codes.get(code)
        if found is None:
            found = self._codes[code] = ua.StatusCode(code)
        return found

"""The values of all signals in the address space: written when changed, copied never."""

import math
from collections.abc import Callable, Coroutine, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
from asyncua import ua

from hilserver.core.clock import UtcClock
from hilserver.image import Frame
from hilserver.io.opcua_server.logs import log
from hilserver.io.opcua_server.model import DATA_TYPES
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


class FixedDataValue(ua.DataValue):  # type: ignore[misc]
    """A DataValue that nobody changes after it is made, so a copy of it is the object itself.

    asyncua deep-copies every value for every subscriber (27 us); the copy guards against a value
    that changes later, which one of these never does.
    """

    __slots__ = ()

    def __deepcopy__(self, memo: dict[int, Any]) -> "FixedDataValue":
        return self


def run_to_end(coroutine: Coroutine[Any, Any, Any], what: str) -> None:
    """Run a coroutine of asyncua that never waits, here and now.

    Notifications only append to queues (`guard` sees to it that no subscription publishes from
    there), so they need no task of their own. One that fails or waits harms nobody else.
    """
    try:
        coroutine.send(None)
    except StopIteration:
        return
    except Exception as error:  # noqa: BLE001 - a client's filter must not stop the others
        log.warning(
            "opcua notification failed", what=what, error=f"{type(error).__name__}: {error}"
        )
        return
    coroutine.close()
    log.warning("opcua notification had to wait and was dropped", what=what)


def write_value(place: Any, value: ua.DataValue) -> None:
    """Put a value into the address space and tell its subscribers.

    Parameters
    ----------
    place : asyncua AttributeValue
        Where asyncua keeps the value and the callbacks of its monitored items.
    """
    place.value = value
    for handle, callback in tuple(place.datachange_callbacks.items()):
        run_to_end(callback(handle, value), "data change")


def worst(codes: list[int]) -> int:
    """Return the worst status code: bad before uncertain before good."""
    return max(codes, key=lambda code: (code >> _SEVERITY_SHIFT) & 3)


@dataclass(frozen=True, slots=True, eq=False)
class _Variable:
    signal: Signal
    place: Any
    variant_type: ua.VariantType
    convert: Callable[[float], Any]


class SignalVariables:
    """All variables that show signals.

    Parameters
    ----------
    places : mapping
        Signal name to asyncua's AttributeValue.

    Notes
    -----
    A value is written when its bits or its status code differ from those written before. What a
    client has just written is shown at once and kept until the first frame that contains it, so
    that a client reads what it wrote and no older frame puts the old value back.
    """

    def __init__(self, table: SignalTable, places: Mapping[str, Any], clock: UtcClock) -> None:
        self._clock = clock
        self._by_slot: list[list[_Variable]] = [[] for _ in range(table.n_slots)]
        self._by_name: dict[str, _Variable] = {}
        for signal in table:
            kind = ua.VariantType(DATA_TYPES[signal.type])
            variable = _Variable(signal, places[signal.name], kind, _CONVERT[signal.type])
            self._by_name[signal.name] = variable
            for slot in signal.slots:
                self._by_slot[slot].append(variable)
        self._values = np.zeros(table.n_slots)
        self._bits = self._values.view(np.int64)
        self._status = np.full(table.n_slots, _NEVER_WRITTEN, dtype=np.int64)
        self._held_until = np.zeros(table.n_slots, dtype=np.int64)
        self._is_any_held = False
        self._codes: dict[int, ua.StatusCode] = {}

    def publish(self, frame: Frame) -> int:
        """Write what changed since the last frame; return the number of variables written."""
        bits = frame.values.view(np.int64)
        changed = (bits != self._bits) | (frame.status != self._status)
        if self._is_any_held:
            changed = self._release(changed, frame.latched_rows)
        slots = np.flatnonzero(changed)
        if slots.size == 0:
            return 0
        self._bits[slots] = bits[slots]
        self._status[slots] = frame.status[slots]
        return self._write(slots.tolist(), self._clock.utc(frame.planned_ns))

    def show_written(self, values: Mapping[str, tuple[float, ...]], pushed_rows: int) -> None:
        """Show accepted writes until a frame has latched `pushed_rows` rows."""
        slots: list[int] = []
        for name, numbers in values.items():
            for slot, number in zip(self._by_name[name].signal.slots, numbers, strict=True):
                self._values[slot] = number
                slots.append(slot)
        self._status[slots] = 0
        self._held_until[slots] = pushed_rows
        self._is_any_held = True
        self._write(slots, datetime.now(UTC))

    def _release(self, changed: Any, latched_rows: int) -> Any:
        """Return which slots to write: held ones not before, and then in any case."""
        held = self._held_until > latched_rows
        released = (self._held_until > 0) & ~held
        self._held_until[released] = 0
        self._is_any_held = bool(held.any())
        return (changed | released) & ~held

    def _write(self, slots: list[int], stamp: datetime) -> int:
        now = datetime.now(UTC)
        values, status = self._values.tolist(), self._status.tolist()
        # An array is touched by four slots and written once; a dict keeps the order.
        touched = dict.fromkeys(v for slot in slots for v in self._by_slot[slot])
        for variable in touched:
            write_value(variable.place, self._data_value(variable, values, status, stamp, now))
        return len(touched)

    def _data_value(
        self,
        variable: _Variable,
        values: list[float],
        status: list[int],
        stamp: datetime,
        now: datetime,
    ) -> FixedDataValue:
        slots = variable.signal.slots
        code = status[slots[0]] if len(slots) == 1 else worst([status[slot] for slot in slots])
        numbers = [values[slot] for slot in slots]
        if code < 0:
            code = int(ua.StatusCodes.BadWaitingForInitialData)
        elif code >> _SEVERITY_SHIFT < _BAD and not all(map(math.isfinite, numbers)):
            # A model that computed no number has no value, whatever status it set.
            code = int(ua.StatusCodes.BadSensorFailure)
        if code >> _SEVERITY_SHIFT >= _BAD:
            return FixedDataValue(_NO_VALUE, self._code(code), stamp, now)
        if variable.signal.is_array:
            array = [variable.convert(number) for number in numbers]
            variant = ua.Variant(array, variable.variant_type, None, True)
        else:
            variant = ua.Variant(variable.convert(numbers[0]), variable.variant_type, None, False)
        return FixedDataValue(variant, self._code(code), stamp, now)

    def _code(self, code: int) -> ua.StatusCode:
        found = self._codes.get(code)
        if found is None:
            found = self._codes[code] = ua.StatusCode(code)
        return found

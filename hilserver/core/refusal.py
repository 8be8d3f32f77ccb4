"""Why a value is not accepted: what is checked of it by itself, and what goes with it."""

from collections.abc import Iterable, Sequence
from enum import StrEnum
from typing import Final

from hilserver.core.leases import OFFERING, kind_of
from hilserver.plant.layout import N_SETPOINTS, Inputs
from hilserver.signals import AUTOMATIC, Signal, SignalTable, ValueType
from hilserver.signals.numbers import is_finite_number


class Refusal(StrEnum):
    """Why a value was not accepted."""

    UNKNOWN_SIGNAL = "unknown_signal"
    NOT_WRITABLE = "not_writable"
    TYPE_MISMATCH = "type_mismatch"
    NOT_FINITE = "not_finite"
    OUT_OF_RANGE = "out_of_range"
    NOT_IN_CONTROL = "not_in_control"
    QUEUE_FULL = "queue_full"
    OUTDATED = "outdated"
    NOT_AT_REST = "not_at_rest"
    NOT_STARTED = "not_started"
    NOT_GRANTED = "not_granted"
    INCOMPLETE = "incomplete"


SENTENCES: Final = {
    Refusal.OUTDATED: "it arrived before Reset, Pause or LoadSnapshot discarded the commands",
    Refusal.NOT_AT_REST: "it was held over Reset, Pause or LoadSnapshot; let go first, then drive",
    Refusal.NOT_STARTED: "automatic sources wait for Start after a safe state: call Start",
    Refusal.INCOMPLETE: (
        "another value of the same command was refused; one acts whole or not at all"
    ),
}
"""Reasons that need nothing but themselves to be understood."""

CHOOSING: Final = frozenset({"opcua", "page"})  # they choose their signals at run time
_WITH_HANDS: Final = frozenset({"opcua", "page", "ros2"})  # a person may drive by them

_MODE: Final = Inputs.where("mode").start
_COMMANDS: Final = (
    range(Inputs.where("twist_linear").start),
    range(Inputs.where("twist_linear").start, Inputs.where("duty").start),
    range(Inputs.where("duty").start, N_SETPOINTS),
)
"""Inputs that make up a command: wheel set-points, twist, duties; the mode belongs to each."""


def reasons_of(source: str, *, is_door: bool = False) -> set[Refusal]:
    """Return why a source can be refused; `is_door`: it needs a grant of its section."""
    reasons = set(Refusal)
    reasons.discard(Refusal.INCOMPLETE)  # the value that was wrong is counted instead
    if source not in CHOOSING:
        # Its configuration names the signals, and only finite numbers leave a link or a scenario.
        reasons -= {Refusal.UNKNOWN_SIGNAL, Refusal.NOT_WRITABLE}
        reasons -= {Refusal.TYPE_MISMATCH, Refusal.NOT_FINITE}
    if source == "scenario":
        reasons.discard(Refusal.OUTDATED)  # nothing of it waits to be read
    if source not in _WITH_HANDS:
        reasons.discard(Refusal.NOT_AT_REST)
    if kind_of(source) not in AUTOMATIC - OFFERING:
        # a link that repeats itself is not counted
        reasons.discard(Refusal.NOT_STARTED)
    if not is_door:
        reasons.discard(Refusal.NOT_GRANTED)
    return reasons


def check_value(signal: Signal, value: object) -> tuple[float, ...] | Refusal:
    """Return the value as one float per slot, or the reason why it is refused."""
    if not signal.is_array:
        parts: Sequence[object] = (value,)
    elif isinstance(value, Sequence) and not isinstance(value, str | bytes):
        parts = value
    else:
        return Refusal.TYPE_MISMATCH
    if len(parts) != len(signal.slots):
        return Refusal.TYPE_MISMATCH
    numbers: list[float] = []
    for part in parts:
        is_boolean = isinstance(part, bool)
        if not isinstance(part, int | float) or is_boolean != (
            signal.type is ValueType.BOOLEAN
        ):
            return Refusal.TYPE_MISMATCH
        if not is_boolean and not is_finite_number(part):
            return Refusal.NOT_FINITE
        if signal.type is not ValueType.DOUBLE and part != int(part):
            return Refusal.TYPE_MISMATCH
        if not signal.low <= part <= signal.high:
            return Refusal.OUT_OF_RANGE
        numbers.append(float(part))
    return tuple(numbers)


def spoiled(wrong: Iterable[str], table: SignalTable) -> set[int]:
    """Return the slots of the commands that cannot be whole without these names."""
    slots_of_commands = set[int]()
    for name in wrong:
        slots: tuple[int, ...] = (_MODE,)
        if name in table and not table[name].hidden:
            slots = tuple(table[name].slots)
        for command in _COMMANDS:
            if _MODE in slots or slots[0] in command:
                slots_of_commands.update(command)
    return slots_of_commands | {_MODE} if slots_of_commands else slots_of_commands

"""Faults of the paced loop, for which it requests the safe state: each code with name and text.

The step receives the code in its ``FAULT`` phase and keeps the first one; the state machine reads
it there and shows the text. The compiled code compares plain integers.
"""

from typing import Final, NamedTuple

SINGLE_OVERRUN: Final = 1
CONSECUTIVE_OVERRUNS: Final = 2
COMMUNICATION: Final = 3
SILENCE: Final = 4
# returned by the mechatronic model's slice when its numbers are invalid
BODY: Final = 1000

SLICE: Final = 16  # ``SLICE + n``: a slice returned the fault number n > 0


class PlantFault(NamedTuple):
    """Name of a fault for logs and tests, and the sentence that a user reads."""

    name: str
    text: str


_FAULTS: Final = {
    SINGLE_OVERRUN: PlantFault(
        "single_overrun_limit",
        "a single overrun was longer than scheduler.limits allow",
    ),
    CONSECUTIVE_OVERRUNS: PlantFault(
        "consecutive_overrun_limit",
        "more consecutive overruns than scheduler.limits allow",
    ),
    SLICE + BODY: PlantFault(
        "mechatronic",
        "the mechatronic model has left its valid range and is halted until SetPose or Reset",
    ),
    SILENCE: PlantFault("silence", "the source in control is silent"),
    COMMUNICATION: PlantFault(
        "communication", "the communication side did not answer in time"
    ),
}


def fault_of(code: int) -> PlantFault:
    """Return name and text of a code."""
    number = code - SLICE
    return _FAULTS.get(code) or PlantFault(
        f"fault {number}", f"a slice reported fault {number}"
    )

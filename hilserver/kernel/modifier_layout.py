"""The layout of the active modifiers (faults and forced signals) in the arena.

The region ``modifiers`` is live: a snapshot holds every active fault with its delay ring, so a run
that continues from it gives the same bits. Commands come in through the fixed region
``modifier_mail``, a queue with one producer (the event loop) and one consumer (the latch).
"""

from enum import IntEnum
from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray

from hilserver.compiled.records import Record

MAX_MODIFIERS: Final = 32
MAX_RINGS: Final = 8  # each adds 8 kB to every snapshot and recorded state
RING_TICKS: Final = 1024  # a power of two
MAX_DELAY_TICKS: Final = RING_TICKS - 1
FOREVER: Final = 2**62
NOW: Final = -1


class Kind(IntEnum):
    """What a modifier does to its signal."""

    STUCK = 1
    NOISE = 2
    BIAS = 3
    SCALE = 4
    DELAY = 5
    JITTER = 6
    DROP = 7
    REORDER = 8
    HOLD = 9
    QUANTISE = 10
    SPIKE = 11
    DISCONNECT = 12
    FORCE = 13
    SWAP = 14
    UNSIGNED = 15
    LAST_WHEEL = 16
    DEAD_TIMEOUT = 17


RING_KINDS: Final = (Kind.DELAY, Kind.JITTER, Kind.REORDER)

INPUT: Final = 0
OUTPUT: Final = 1
NEITHER: Final = 2

Slots = Annotated[NDArray[np.int64], 2 * MAX_MODIFIERS]
Raw = Annotated[NDArray[np.float64], 2 * MAX_MODIFIERS]
Rings = Annotated[NDArray[np.float64], (MAX_RINGS, RING_TICKS)]


class ModifierEntry(Record):
    """One modifier: the fields of the command, then the state that the step keeps."""

    number: int
    kind: int
    slot: int
    other: int  # second slot of SWAP and LAST_WHEEL
    side: int  # INPUT, OUTPUT or NEITHER
    from_tick: int  # or NOW
    until_tick: int  # with NOW: duration
    seed: int
    every: int  # ticks per sample
    ticks: int  # delay
    spread: int  # largest additional delay
    a: float  # value, deviation, offset, factor, step, size, rpm per m/s
    b: float  # probability; 1: STUCK has a value; rpm per rad/s
    c: float  # max_rpm
    is_integer: int  # 1: only whole numbers between low and high
    low: float
    high: float
    channel: int  # of the noise
    unused: Annotated[NDArray[np.int64], 2]
    start: int  # tick at which it began to act, -1 before
    ring: int  # -1: none
    last: int  # tick of the newest evaluation
    previous: float  # state before that tick
    state: float  # state after it
    free: Annotated[NDArray[np.int64], 7]


class Modifiers(Record):
    """The region: head, entries, what the modified slots held, delay rings."""

    count: int  # entries in use
    touched: int  # slots that now hold a modified value
    rings_in_use: int  # one bit per ring
    dropped: int  # commands for which there was no room
    timeout_dead: int  # 1: the command time-out is disabled
    last_command: int  # tick of the last set-point
    timeouts: int  # how often the command time-out has fired
    silent: int  # 1 while the time-out holds
    free: Annotated[NDArray[np.int64], 8]
    entries: Annotated[list[ModifierEntry], MAX_MODIFIERS]
    slots: Slots  # the touched ones
    raw_value: Raw  # their true values
    raw_status: Slots
    rings: Rings


# --- the mail -------------------------------------------------------------------------------------
OP_ADD: Final = 1
OP_REMOVE: Final = 2  # the entries with this id
OP_CLEAR: Final = 3  # all but forces
OP_CLEAR_ALL: Final = 4
OP_SKIP_TIMED: Final = 5  # timed input rows up to this number
MAIL_ROWS: Final = 128  # a power of two


class Mail(Record):
    """One command: a new entry, or an operation on entries, by number or all."""

    operation: int  # OP_*
    entry: ModifierEntry


MODIFIERS: Final = Modifiers.layout
MAIL: Final = Mail.layout
MAIL_ROW: Final = Mail.n_words
REGIONS_LIVE: Final = {"modifiers": Modifiers.n_words}
REGIONS_FIXED: Final = {"modifier_mail": MAIL_ROWS * MAIL_ROW}

"""Where the active modifiers (faults and forced signals) lie in the arena.

The region ``modifiers`` is live: a snapshot holds every active fault with its delay ring, and the
run that continues it gives the same bits. Commands come in through the fixed region
``modifier_mail``, a queue with one producer (the event loop) and one consumer (the latch).
"""

from enum import IntEnum
from typing import Final

MAX_MODIFIERS: Final = 32
MAX_RINGS: Final = 8  # each is part of every snapshot and recorded state, 8 kB
RING_TICKS: Final = 1024  # a power of two
MAX_DELAY_TICKS: Final = RING_TICKS - 1
FOREVER: Final = 2**62
NOW: Final = -1


class Kind(IntEnum):
    """What a modifier does with its signal."""

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

# --- one entry: what the command brings ---------------------------------------------------------
E_ID: Final = 0
E_KIND: Final = 1
E_SLOT: Final = 2
E_OTHER: Final = 3  # second slot of SWAP and LAST_WHEEL
E_SIDE: Final = 4  # INPUT, OUTPUT or NEITHER
E_FROM: Final = 5  # tick, or NOW
E_UNTIL: Final = 6  # tick; with NOW: duration
E_SEED: Final = 7
E_EVERY: Final = 8  # ticks of one sample
E_TICKS: Final = 9  # delay
E_SPREAD: Final = 10  # largest additional delay
E_A: Final = 11  # float: value, deviation, offset, factor, step, size, rpm per m/s
E_B: Final = 12  # float: probability; 1: STUCK has a value; rpm per rad/s
E_C: Final = 13  # float: max_rpm
E_INTEGER: Final = 14  # 1: whole numbers between E_LOW and E_HIGH only
E_LOW: Final = 15  # float
E_HIGH: Final = 16  # float
E_CHANNEL: Final = 17  # of the noise
N_COMMAND: Final = 20
# --- and what it remembers ----------------------------------------------------------------------
E_START: Final = 20  # tick at which it began to act, -1 before
E_RING: Final = 21
E_LAST: Final = 22  # tick of the newest evaluation
E_PREVIOUS: Final = 23  # float: state before that tick
E_STATE: Final = 24  # float: state after it
N_ENTRY: Final = 32

INPUT: Final = 0
OUTPUT: Final = 1
NEITHER: Final = 2

# --- the region: header, entries, what the modified slots held, rings -----------------------------
H_COUNT: Final = 0
H_TOUCHED: Final = 1  # slots that hold a modified value now
H_RINGS: Final = 2  # one bit for each ring in use
H_DROPPED: Final = 3  # commands for which there was no room
H_TIMEOUT_DEAD: Final = 4  # 1: the command time-out is defeated
H_LAST_COMMAND: Final = 5  # tick of the last set-point
H_TIMEOUTS: Final = 6  # how often the command time-out has fired
H_SILENT: Final = 7  # 1 while it holds
ENTRIES: Final = 16
TOUCHED: Final = ENTRIES + MAX_MODIFIERS * N_ENTRY
RAW_VALUE: Final = TOUCHED + 2 * MAX_MODIFIERS
RAW_STATUS: Final = RAW_VALUE + 2 * MAX_MODIFIERS
RINGS: Final = RAW_STATUS + 2 * MAX_MODIFIERS
N_MODIFIER_WORDS: Final = RINGS + MAX_RINGS * RING_TICKS

# --- the mail -------------------------------------------------------------------------------------
OP_ADD: Final = 1
OP_REMOVE: Final = 2  # the entries with this id
OP_CLEAR: Final = 3  # all but forces
OP_CLEAR_ALL: Final = 4
OP_SKIP_TIMED: Final = 5  # timed input rows up to this number
MAIL_ROWS: Final = 128  # a power of two
MAIL_ROW: Final = 1 + N_COMMAND
N_MAIL_WORDS: Final = MAIL_ROWS * MAIL_ROW

REGIONS_LIVE: Final = {"modifiers": N_MODIFIER_WORDS}
REGIONS_FIXED: Final = {"modifier_mail": N_MAIL_WORDS}

"""Where the numbers of an FMU lie: its addresses `a`, what it remembers `x`, what a child shares.

`a` (int64) is of this process and no part of a snapshot. `x` (float64, the state's bytes behind its
head) is what a snapshot holds.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

# --- a: functions and places in the FMU -----------------------------------------------------------
(
    A_INSTANCE,
    A_VERSION,  # 2 or 3
    A_DO_STEP,
    A_GET_STATE,  # 0: it cannot store its state
    A_SET_STATE,
    A_FREE_STATE,
    A_STATE_SIZE,
    A_SERIALIZE,
    A_DESERIALIZE,
    A_STATE,  # the FMU's own copy of its state, a pointer
    A_SIZE,  # size_t that it writes
    A_EVENT,  # booleans and a time that doStep of 3.0 writes
    A_TERMINATE,
    A_EARLY,
    A_LAST_TIME,
    A_CAPACITY,  # bytes that a state may have
    A_INPUTS,  # rows: variables of one type that follow each other go through one call
    A_PARAMETERS,
    A_OUTPUTS,
    A_FRESH,  # 1: all parameters are set before the next step
    A_STATUS,  # first status worse than a warning, see `Status`
    A_SINCE,  # CLOCK_MONOTONIC at which the call began that has not come back [ns]; 0: none
    A_SLOW,  # calls longer than this are noted [ns]
    A_NOTED,  # how many were
    A_TIMESPEC,
    A_TIMESPEC_END,
    A_SHARED,  # address of the words shared with a child; 0: it runs here
    A_SHARED_LENGTH,
    A_BELL,  # file descriptor that wakes the child
    A_ONE,
    A_WAITS,  # 1: in virtual time the step waits for the child
    A_LIMIT,  # slices without an answer that are too many
    A_DEAD,  # 1: the child has ended
    A_LATE,  # slices in which the child had not answered
    A_ASKED,  # CLOCK_MONOTONIC of the last ask [ns]
    A_HURRIED,  # slices among the late ones that came before a slice of time had passed
    A_SCRATCH,  # index of room for numbers that are no float64
    A_KNOWN,  # index of the parameters as they were set last
    A_STEPS,  # steps done, for an FMU that cannot go back
) = range(39)
N_HEAD: Final = 39

SLOW_CALLS: Final = 256
"""Pairs of tick and duration [ns] behind the head: the slow calls, the newest over the oldest."""
ROWS: Final = N_HEAD + 2 * SLOW_CALLS  # rows of calls: inputs, parameters, outputs
R_REFERENCES, R_VARIABLES, R_COUNT, R_BYTES, R_KIND, R_FUNCTION = range(6)
"""Index of the references (uint32), number of variables and values, their type, the function."""
CALL_WORDS: Final = 6

FLOAT, SIGNED, UNSIGNED, BOOLEAN = range(4)  # kinds of numbers

# --- x: what a snapshot holds ---------------------------------------------------------------------
X_STEPS: Final = 0  # steps that the stored state has seen
X_PENDING: Final = 1  # steps that a child has been asked for since
X_OWED: Final = 2  # slices that passed since it was asked
X_FAILED: Final = 3
X_LATE: Final = 4  # slices without an answer so far
X_BYTES: Final = 5
X_STATE: Final = 6

# --- words that a child shares --------------------------------------------------------------------
S_ASKED, S_DONE, S_LOAD, S_STEPS, S_PENDING, S_STATUS, S_CURRENT = range(7)
S_MESSAGE: Final = 7
MESSAGE_WORDS: Final = 32
N_SHARED: Final = S_MESSAGE + MESSAGE_WORDS
"""Then inputs, parameters, outputs, two states after a step, two states to go on from; a state is
its number of bytes and the bytes."""

OK, WARNING, DISCARD, ERROR, FATAL, PENDING = range(6)  # what a function of an FMU answers
EVENT_NEEDED, TERMINATED, STATE_TOO_LARGE, STATE_UNFIT, SILENT = range(16, 21)
"""What we find beside that."""

STATUS: Final = {
    DISCARD: "discard",
    ERROR: "error",
    FATAL: "fatal error",
    PENDING: "pending",
    EVENT_NEEDED: "needs event mode, which a time slice has not",
    TERMINATED: "asks to end the simulation",
    STATE_TOO_LARGE: "its state has grown to more than twice its first size",
    STATE_UNFIT: "its stored state is damaged",
    SILENT: "its process does not answer",
}
"""Both in words."""


def slow_call(a: NDArray[np.int64], tick: int) -> int:
    """Return how long [ns] the call of an FMU took in a tick, 0 if it was not slow."""
    calls_made = a[N_HEAD:ROWS].reshape(-1, 2)[: int(a[A_NOTED])]
    found = calls_made[calls_made[:, 0] == tick, 1]
    return int(found.max()) if found.size else 0


def hangs_since(a: NDArray[np.int64]) -> int:
    """Return the CLOCK_MONOTONIC [ns] at which a call began that has not come back; 0: none."""
    return int(a[A_SINCE])

"""Where the numbers of an FMU lie: its addresses `a`, what it remembers `x`, what a child shares.

`a` (int64) belongs to this process and is no part of a snapshot. `x` (float64, a head and the
state's bytes) is what a snapshot holds.
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
    A_SIZE,  # a size_t that the FMU writes
    A_EVENT,  # booleans and a time that doStep of FMI 3.0 writes
    A_TERMINATE,
    A_EARLY,
    A_LAST_TIME,
    A_CAPACITY,  # largest size of a state [bytes]
    A_INPUTS,  # number of rows: consecutive variables of one type share a call
    A_PARAMETERS,
    A_OUTPUTS,
    A_FRESH,  # 1: all parameters are set before the next step
    A_STATUS,  # first status worse than a warning, see `Status`
    A_SINCE,  # CLOCK_MONOTONIC at the start of a call that has not returned [ns]; 0: none
    A_SLOW,  # calls longer than this are noted [ns]
    A_NOTED,  # how many were noted
    A_TIMESPEC,
    A_TIMESPEC_END,
    A_SHARED,  # address of the words shared with a child; 0: it runs here
    A_SHARED_LENGTH,
    A_BELL,  # file descriptor that wakes the child
    A_ONE,
    A_WAITS,  # 1: in virtual time the step waits for the child
    A_LIMIT,  # it is given up after this long without an answer [ns]
    A_SILENT,  # how long it has not answered, though it had the time to [ns]
    A_DEAD,  # 1: the child has ended
    A_LATE,  # slices in which the child had not answered
    A_RAN,  # CLOCK_MONOTONIC of the last run of the slice [ns]
    A_HURRIED,  # late slices that came before a slice of time had passed
    A_SCRATCH,  # index of scratch space for numbers other than float64
    A_KNOWN,  # index of the parameters as last set
    A_STEPS,  # steps done, for an FMU whose state cannot be restored
) = range(40)
N_HEAD: Final = 40

SLOW_CALLS: Final = 256
"""Pairs of tick and duration [ns] after the head; a new slow call overwrites the oldest."""
ROWS: Final = N_HEAD + 2 * SLOW_CALLS  # rows of calls: inputs, parameters, outputs
R_REFERENCES, R_VARIABLES, R_COUNT, R_BYTES, R_KIND, R_FUNCTION = range(6)
"""Index of the references (uint32), counts of variables and values, type, function."""
CALL_WORDS: Final = 6

FLOAT, SIGNED, UNSIGNED, BOOLEAN = range(4)  # kinds of numbers

# --- x: what a snapshot holds ---------------------------------------------------------------------
X_STEPS: Final = 0  # steps that the stored state has seen
X_PENDING: Final = 1  # steps that a child was asked for since
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
"""Then inputs, parameters, outputs, two states after a step, two states to restore; a state is
its number of bytes and the bytes."""

# what a function of an FMU returns
OK, WARNING, DISCARD, ERROR, FATAL, PENDING = range(6)
EVENT_NEEDED, TERMINATED, STATE_TOO_LARGE, STATE_UNFIT, SILENT = range(16, 21)
"""Further failures that we detect."""

STATUS: Final = {
    DISCARD: "discard",
    ERROR: "error",
    FATAL: "fatal error",
    PENDING: "pending",
    EVENT_NEEDED: "needs event mode, which a time slice does not have",
    TERMINATED: "asks to end the simulation",
    STATE_TOO_LARGE: "its state has grown to more than twice its first size",
    STATE_UNFIT: "its stored state is damaged",
    SILENT: "its process does not answer",
}
"""All of these in words."""


def slow_call(a: NDArray[np.int64], tick: int) -> int:
    """Return the duration [ns] of an FMU's call in a tick, 0 if it was not slow."""
    noted = a[N_HEAD:ROWS].reshape(-1, 2)
    calls_made = noted[: int(a[A_NOTED])]
    found = calls_made[calls_made[:, 0] == tick, 1]
    return int(found.max()) if found.size else 0


def hangs_since(a: NDArray[np.int64]) -> int:
    """Return the CLOCK_MONOTONIC [ns] at the start of a call that has not returned; 0: none."""
    return int(a[A_SINCE])

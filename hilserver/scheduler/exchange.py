"""The words through which event loop and pacing loop communicate, without waiting for each other.

Every word has one writer: the event loop writes requests, the pacing loop what it has done. Loads
and stores are atomic, and every word has its meaning without a second one:

command
    ``FREE_RUN``, or ``(generation << 32) | n``: paused after exactly n more ticks. As it is one
    word, a step request can be neither lost nor run twice, whatever the loop is doing meanwhile.
acknowledged
    The last command that has been completed (for n steps: all n are done).

Communication slices have one row each; its sequence number is odd while the loop writes it.
Overruns go into a bounded ring; the loop never waits for room, but counts what does not fit.
"""

from dataclasses import dataclass, fields

import numpy as np
from numba.core import types
from numpy.typing import NDArray

from hilserver.compiled import inlined, kernel
from hilserver.compiled.atomics import fence, load_acquire, store_release

# Written by the event loop
COMMAND, PACED_PERIOD, STOP_REQUEST, RECORDS_TAKEN = range(4)
# Written by the pacing loop
ACKNOWLEDGED, HEARTBEAT, NEXT_TICK, TICKS_DONE, STOPPED, RECORDS_MADE, RECORDS_LOST = (
    range(8, 15)
)
N_CONTROL = 16

FREE_RUN = -1
MAX_STEPS = 2**32 - 1

# One row per communication slice
COMM_SEQUENCE, COMM_TICK, COMM_PLANNED, COMM_PERIOD_TICKS = range(4)
N_COMM = 4

MOST_RECORDS = 256

_WORDS = types.int64[::1]


@dataclass(frozen=True, slots=True)
class OverrunRecord:
    """One overrun or fault as the pacing loop saw it, a row of the ring; times in ns."""

    tick: int
    # ``LATE_WAKE`` or ``LONG_RUN`` of the law; 0 for a fault without an overrun
    kind: int
    # row of the slice that is blamed: the first for a late wake, otherwise the longest
    slice_index: int
    planned_ns: int
    latency_ns: int
    execution_ns: int
    # usage of the thread since the end of the previous tick
    cpu_ns: int
    minor_faults: int
    major_faults: int
    preempted: int
    missed: int  # planned starts that the policy gave up
    code: int  # code in `faults` passed to the step; -1: the scheduler stopped; 0: none


@inlined
def announce(comm: NDArray[np.int64], row: int, tick: int, planned_ns: int) -> None:
    """Tell the event loop that communication slice `row` is due."""
    base = row * N_COMM
    sequence = comm[base + COMM_SEQUENCE]
    store_release(comm, base + COMM_SEQUENCE, sequence + 1)
    fence()
    comm[base + COMM_TICK] = tick
    comm[base + COMM_PLANNED] = planned_ns
    store_release(comm, base + COMM_SEQUENCE, sequence + 2)


@kernel(types.int64(_WORDS, types.int64, _WORDS))
def announced(comm: NDArray[np.int64], row: int, out: NDArray[np.int64]) -> int:
    """Read what was last announced for slice `row`.

    Parameters
    ----------
    comm, row
        All rows and the index of one.
    out : ndarray of int64, shape (2,)
        Receives tick and planned start [ns].

    Returns
    -------
    int
        Number of announcements so far; -1 if every attempt met the writer.
    """
    base = row * N_COMM
    for _ in range(64):
        before = load_acquire(comm, base + COMM_SEQUENCE)
        if before % 2 == 0:
            out[0] = comm[base + COMM_TICK]
            out[1] = comm[base + COMM_PLANNED]
            fence()
            if load_acquire(comm, base + COMM_SEQUENCE) == before:
                return int(before // 2)
    return -1


@inlined
def next_record(control: NDArray[np.int64], ring: NDArray[np.int64]) -> int:
    """Return the ring's row for a new record, or -1 (counted as lost) if it is full."""
    made = control[RECORDS_MADE]
    if made - load_acquire(control, RECORDS_TAKEN) >= ring.shape[0]:
        control[RECORDS_LOST] += 1
        return -1
    return int(made % ring.shape[0])


@kernel(types.int64(_WORDS, types.int64))
def read_word(control: NDArray[np.int64], index: int) -> int:
    """Load one control word (acquire)."""
    return int(load_acquire(control, index))


@kernel(types.void(_WORDS, types.int64, types.int64))
def write_word(control: NDArray[np.int64], index: int, value: int) -> None:
    """Store one control word (release)."""
    store_release(control, index, value)


class Exchange:
    """The event loop's side of the words."""

    def __init__(
        self, base_period_ns: int, comm_period_ticks: list[int], first_tick: int = 0
    ) -> None:
        self.control = np.zeros(N_CONTROL, dtype=np.int64)
        self.comm = np.zeros(len(comm_period_ticks) * N_COMM, dtype=np.int64)
        self.comm[COMM_PERIOD_TICKS::N_COMM] = comm_period_ticks
        self.ring = np.zeros((MOST_RECORDS, len(fields(OverrunRecord))), dtype=np.int64)
        self._generation = 0
        self.control[COMMAND] = FREE_RUN
        self.control[PACED_PERIOD] = base_period_ns
        self.control[NEXT_TICK] = first_tick

    def get(self, word: int) -> int:
        """Load one control word."""
        return int(read_word(self.control, word))

    def pause(self) -> None:
        """Pause before the next tick."""
        self._generation += 1
        write_word(self.control, COMMAND, self._generation << 32)

    def resume(self) -> None:
        """Run freely."""
        write_word(self.control, COMMAND, FREE_RUN)

    def step(self, n_ticks: int) -> None:
        """Run exactly `n_ticks` more and pause; these add to the rest of an unfinished step."""
        if not 1 <= n_ticks <= MAX_STEPS:
            raise ValueError(f"a step runs 1 to {MAX_STEPS} ticks, not {n_ticks}")
        command = self.get(COMMAND)
        if command == FREE_RUN or (command & MAX_STEPS) + n_ticks > MAX_STEPS:
            self._generation += 1
            command = self._generation << 32
        write_word(self.control, COMMAND, command + n_ticks)

    def set_paced_period(self, period_ns: int) -> None:
        """Change the real duration of a tick, from the next one on."""
        write_word(self.control, PACED_PERIOD, period_ns)

    def request_stop(self) -> None:
        """Ask the loop to end."""
        write_word(self.control, STOP_REQUEST, 1)

    @property
    def standing(self) -> bool:
        """True when a pause, or all ticks of a step, have been carried out."""
        command = self.get(COMMAND)
        return command != FREE_RUN and self.get(ACKNOWLEDGED) == command

    def take_record(self, ended_before_ns: int) -> OverrunRecord | None:
        """Take the oldest record if its tick ended before `ended_before_ns`."""
        taken = self.get(RECORDS_TAKEN)
        if taken == self.get(RECORDS_MADE):
            return None
        record = OverrunRecord(*self.ring[taken % MOST_RECORDS].tolist())
        if (
            record.planned_ns + record.latency_ns + record.execution_ns
            > ended_before_ns
        ):
            return None
        write_word(self.control, RECORDS_TAKEN, taken + 1)
        return record

"""Who drives, inside the step: a row of commands per kind of source, and leases that limit it.

A source writes to the row of its kind, through the queues; indices beyond the last slot of a frame
address these rows. The step takes the row of the kind that has control, under a lease. The lease
lapses in the step, by the policy of the source that holds it, even if Python hangs or has died.
"""

import math
from typing import Annotated, Any, Final

import numpy as np
from numpy.typing import NDArray

from hilserver.compiled import inlined, part
from hilserver.compiled.records import Record, record_at
from hilserver.image import word
from hilserver.status import GOOD

REGION: Final = "leases"
KINDS: Final = 6
ROW: Final = 16  # words of a row; set-points, mode and enable come first
FIRST_OFFERING: Final = 3  # kinds from here on make offers even without control
NO_KIND: Final = -1


class Lease(Record):
    """The lease of one source."""

    renewed: int  # not 0: renewed by a row in this tick; 1 + age of the renewal [ns]
    since: int  # when the last renewal arrived [ns]; 0: no lease is held
    limit: int  # [ns]; 0: it never lapses
    policy: int
    kind: int
    lapsed: int  # 1: not renewed in time
    stalled: int  # ticks for which the event loop had been silent when it lapsed
    lapses: int  # how many lapses changed a command
    waited: int  # how long the last renewal had waited for the step [ns]


class Driving(Record):
    """The region; the leases follow it."""

    owner: float  # number of the kind that has control
    end: int  # writing it ends every lease
    down: int  # ticks until the previous commands have ramped to zero
    up: int  # ticks until the new row counts in full
    ramp: int  # duration of either ramp [ticks]
    count: int  # leases in use
    free: Annotated[NDArray[np.int64], 10]
    values: Annotated[NDArray[np.float64], (KINDS, ROW)]
    status: Annotated[NDArray[np.int64], (KINDS, ROW)]


LEASE: Final = Lease.layout
DRIVING: Final = Driving.layout
LEASE_WORDS: Final = Lease.n_words
OWNER: Final = Driving.where("owner").start
END: Final = Driving.where("end").start
VALUES: Final = Driving.where("values").start
FIRST_LEASE: Final = Driving.n_words

LAPSE_HOLD, LAPSE_ZERO, LAPSE_SAFE, LAPSE_DEVICE = range(4)
POLICIES: Final = {
    "hold": LAPSE_HOLD,
    "zero": LAPSE_ZERO,
    "ramp": LAPSE_SAFE,
    "device": LAPSE_DEVICE,
}


def words_needed(n_sources: int) -> int:
    """Return the length of the region for `n_sources` leases [words]."""
    return FIRST_LEASE + n_sources * LEASE_WORDS


@inlined
def driving(words: Any) -> Any:
    """Return the region's record; an image without leases has none."""
    return record_at(words, words[word.LEASES], DRIVING)


@inlined
def lease_at(number: int, words: Any) -> Any:
    """Return a lease by its number."""
    return record_at(
        words, words[word.LEASES] + FIRST_LEASE + number * LEASE_WORDS, LEASE
    )


@inlined
def _clear(kind: int, words: Any) -> None:
    """Clear the commands of a row and its leases."""
    d = driving(words)
    for i in range(words[word.SETPOINT_SLOTS]):
        d.values[kind, i] = 0.0
    for number in range(d.count):
        lease = lease_at(number, words)
        if lease.kind == kind:
            lease.renewed = lease.since = 0


@inlined
def _take(kind: int, values: Any, words: Any) -> None:
    """Hand control over: ramp the present set-points to zero, then up to those of the new row."""
    d, frame, n = driving(words), words[word.FRAME_BASE], words[word.SETPOINT_SLOTS]
    moving = False
    for i in range(n):
        moving |= values[frame + i] != 0.0
    before = int(d.owner)
    if 0 <= before < FIRST_OFFERING:  # old commands must not act if it drives again
        _clear(before, words)
        d.values[before, n] = 0.0  # mode: wheels
        d.values[before, n + 1] = 1.0  # enabled
    d.owner = kind
    for number in range(d.count):  # its lease may have lapsed while it only made offers
        lease = lease_at(number, words)
        if lease.kind == kind:
            lease.lapsed = 0
    d.down = d.ramp if moving else 0
    d.up = d.ramp if moving or kind >= FIRST_OFFERING else 0


@inlined
def end_leases(words: Any) -> None:
    """End every lease: nothing is commanded until a source sends a new command."""
    if words[word.LEASES] == 0:
        return
    d = driving(words)
    for kind in range(KINDS):
        _clear(kind, words)
    d.down = 0
    d.up = d.ramp if d.owner >= FIRST_OFFERING else 0


@inlined
def adopt_outcome(now_ns: int, values: Any, words: Any) -> None:
    """Give the source in control the commands of a restored state."""
    d, frame = driving(words), words[word.FRAME_BASE]
    if words[word.LEASES] == 0 or d.owner < 0.0:
        return
    kind = int(d.owner)
    for i in range(words[word.SETPOINT_SLOTS] + 2):
        d.values[kind, i] = values[frame + i]
    for number in range(d.count):
        lease = lease_at(number, words)
        if lease.kind == kind and lease.since != 0:
            lease.since = now_ns
    d.down = d.up = 0


@inlined
def apply_lease(index: int, value: float, status: int, values: Any, words: Any) -> None:
    """Apply an input row addressed to this region; NaN leaves the value."""
    if index == OWNER:
        _take(int(value), values, words)
    elif index == END:
        end_leases(words)
    elif index >= FIRST_LEASE:
        lease_at((index - FIRST_LEASE) // LEASE_WORDS, words).renewed = 1 + int(value)
    else:
        command((index - VALUES) // ROW, (index - VALUES) % ROW, value, status, words)


@part
def command(kind: int, column: int, value: float, status: int, words: Any) -> None:
    """Write one command to the row of a kind; NaN leaves the value."""
    d = driving(words)
    if not math.isnan(value):
        d.values[kind, column] = value
        if column < words[word.SETPOINT_SLOTS] and kind == d.owner:
            words[word.COMMANDED] = 1
    d.status[kind, column] = status


@inlined
def show_outcome(values: Any, words: Any) -> None:
    """Write the commands of the row in control to the frame: set-points, mode, enable."""
    d, frame, status = driving(words), words[word.FRAME_BASE], words[word.STATUS_BASE]
    n, kind = words[word.SETPOINT_SLOTS], int(d.owner)
    down, up = d.down, d.up
    if down > 0:
        d.down = down - 1
        for i in range(n):
            # (n-1)/n (n-2)/(n-1) ... 0/1: in steps of the same size, whatever it began with
            values[frame + i] *= (down - 1) / down
        return
    if kind < 0:
        for i in range(n):
            values[frame + i] = 0.0
            words[status + i] = GOOD
        return
    share = 1.0
    if up > 0:
        d.up = up - 1
        share = 1.0 - (up - 1) / d.ramp
    for i in range(n + 2):
        values[frame + i] = d.values[kind, i] * share if i < n else d.values[kind, i]
        words[status + i] = d.status[kind, i]

"""Who drives, as the step sees it: a row of commands per kind of source, and how long it holds.

A source writes into the row of its kind, through the queues; its index behind the last slot of a
frame says where. The step takes the row of the kind that has control. What is taken is a lease: it
lapses by the policy of the source that holds it, in the step, whatever has become of Python.
"""

from typing import Any, Final

from hilserver.compiled import kernel
from hilserver.image import word
from hilserver.image.status import GOOD

REGION: Final = "leases"
KINDS: Final = 6
ROW: Final = 16
"""Words of a row: the set-points, mode and enable are its first."""
FIRST_OFFERING: Final = 3
"""Kinds from here on say what they want whether or not they have control."""
NO_KIND: Final = -1

# --- the region -----------------------------------------------------------------------------------
OWNER: Final = 0  # float: number of the kind that has control
END: Final = 1  # writing it ends every lease
DOWN: Final = 2  # ticks until what was driven before has come to zero
UP: Final = 3  # ticks until the row counts in full
RAMP: Final = 4  # ticks of either
COUNT: Final = 5  # entries in use
VALUES: Final = 16
STATUS: Final = VALUES + KINDS * ROW
FIRST_ENTRY: Final = STATUS + KINDS * ROW

# --- an entry: the lease of one source ------------------------------------------------------------
RENEWED: Final = 0  # not 0: a row of this tick has renewed it
SINCE: Final = 1  # when it was renewed last [ns]; 0: nothing is held
LIMIT: Final = 2  # [ns]; 0: it never lapses
POLICY: Final = 3
KIND: Final = 4
LAPSED: Final = 5  # 1: not renewed in time
STALLED: Final = 6  # ticks that the event loop had been silent when it lapsed
LAPSES: Final = 7  # how often that has changed what is driven
ENTRY: Final = 8

LAPSE_HOLD, LAPSE_ZERO, LAPSE_SAFE, LAPSE_DEVICE = range(4)
POLICIES: Final = {
    "hold": LAPSE_HOLD,
    "zero": LAPSE_ZERO,
    "ramp": LAPSE_SAFE,
    "device": LAPSE_DEVICE,
}


def words_needed(n_sources: int) -> int:
    """Return the length of the region for so many leases [words]."""
    return FIRST_ENTRY + n_sources * ENTRY


@kernel()
def _clear(kind: int, values: Any, words: Any) -> None:
    """Nothing is commanded in a row, nobody holds it."""
    lease = words[word.LEASES]
    for i in range(words[word.SETPOINT_SLOTS]):
        values[lease + VALUES + kind * ROW + i] = 0.0
    for e in range(words[lease + COUNT]):
        entry = lease + FIRST_ENTRY + e * ENTRY
        if words[entry + KIND] == kind:
            words[entry + RENEWED] = words[entry + SINCE] = 0


@kernel()
def _take(kind: int, values: Any, words: Any) -> None:
    """Hand control over: what drives is ramped to zero, then the new row counts."""
    lease, frame, n = words[word.LEASES], words[word.FRAME_BASE], words[word.SETPOINT_SLOTS]
    moving = False
    for i in range(n):
        moving |= values[frame + i] != 0.0
    before = int(values[lease + OWNER])
    if 0 <= before < FIRST_OFFERING:  # should it drive again, then by what it says from then on
        _clear(before, values, words)
        values[lease + VALUES + before * ROW + n] = 0.0
        values[lease + VALUES + before * ROW + n + 1] = 1.0
    values[lease + OWNER] = kind
    for e in range(words[lease + COUNT]):  # what it offered may have lapsed long ago
        entry = lease + FIRST_ENTRY + e * ENTRY
        if words[entry + KIND] == kind:
            words[entry + LAPSED] = 0
    ramp = words[lease + RAMP]
    words[lease + DOWN] = ramp if moving else 0
    words[lease + UP] = ramp if moving or kind >= FIRST_OFFERING else 0


@kernel()
def end_leases(values: Any, words: Any) -> None:
    """End every lease: nothing is commanded until a source does so anew."""
    lease = words[word.LEASES]
    if lease == 0:
        return
    for kind in range(KINDS):
        _clear(kind, values, words)
    words[lease + DOWN] = 0
    words[lease + UP] = words[lease + RAMP] if values[lease + OWNER] >= FIRST_OFFERING else 0


@kernel()
def adopt_outcome(now_ns: int, values: Any, words: Any) -> None:
    """Let whoever has control command what a state commands that was restored."""
    lease, frame = words[word.LEASES], words[word.FRAME_BASE]
    if lease == 0 or values[lease + OWNER] < 0.0:
        return
    kind = int(values[lease + OWNER])
    for i in range(words[word.SETPOINT_SLOTS] + 2):
        values[lease + VALUES + kind * ROW + i] = values[frame + i]
    for e in range(words[lease + COUNT]):
        entry = lease + FIRST_ENTRY + e * ENTRY
        if words[entry + KIND] == kind and words[entry + SINCE] != 0:
            words[entry + SINCE] = now_ns
    words[lease + DOWN] = words[lease + UP] = 0


@kernel()
def apply_lease(index: int, value: float, status: int, values: Any, words: Any) -> None:
    """Apply a row that is meant for the region; NaN leaves the value."""
    lease = words[word.LEASES]
    if index == OWNER:
        _take(int(value), values, words)
    elif index == END:
        end_leases(values, words)
    elif index >= FIRST_ENTRY:
        words[lease + index] = 1
    else:
        if value == value:  # noqa: PLR0124 - not NaN
            values[lease + index] = value
            kind, column = (index - VALUES) // ROW, (index - VALUES) % ROW
            if column < words[word.SETPOINT_SLOTS] and kind == values[lease + OWNER]:
                words[word.COMMANDED] = 1
        words[lease + index + KINDS * ROW] = status


@kernel()
def show_outcome(values: Any, words: Any) -> None:
    """Write into the frame what the row in control commands: set-points, mode, enable."""
    lease, frame, status = words[word.LEASES], words[word.FRAME_BASE], words[word.STATUS_BASE]
    n, kind = words[word.SETPOINT_SLOTS], int(values[lease + OWNER])
    down, up = words[lease + DOWN], words[lease + UP]
    if down > 0:
        words[lease + DOWN] = down - 1
        for i in range(n):
            values[frame + i] *= (down - 1) / down
        return
    if kind < 0:
        for i in range(n):
            values[frame + i] = 0.0
            words[status + i] = GOOD
        return
    share, row = 1.0, lease + VALUES + kind * ROW
    if up > 0:
        words[lease + UP] = up - 1
        share = 1.0 - (up - 1) / words[lease + RAMP]
    for i in range(n + 2):
        values[frame + i] = values[row + i] * share if i < n else values[row + i]
        words[status + i] = words[row + KINDS * ROW + i]

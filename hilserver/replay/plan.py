"""From a log to stretches: initial state, and the inputs by tick."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hilserver.errors import LogError
from hilserver.image.layout import Layout
from hilserver.logs import Log, RecordedState
from hilserver.logs.log import Change
from hilserver.logs.provenance import FaultCommand
from hilserver.measured.channels import MODE, OF_MODE, TWIST
from hilserver.signals import Direction, SignalTable
from hilserver.status import GOOD, GOOD_LOCAL_OVERRIDE

MAX_TICKS = 10**9
ENABLE = "drive.enable"


@dataclass(frozen=True)
class Stretch:
    """Consecutive ticks, and the inputs that change in them."""

    segment: int
    first_tick: int
    n_ticks: int
    rows: NDArray[np.float64]  # shape (n, 4); tick, slot, value, status; ticks rise
    state: NDArray[np.int64] | None = None  # initial state; None: that of a fresh start
    changes: Sequence[Change] = ()  # of the parameters, in the order of their ticks
    faults: Sequence[FaultCommand] = ()  # likewise


@dataclass(frozen=True)
class Plan:
    """Plan of a replay."""

    stretches: Sequence[Stretch]
    feeds_state: bool  # whether the daemon's state (``sim.state``) comes with the rows
    notices: list[str] = field(default_factory=list)

    @property
    def n_ticks(self) -> int:
        """Number of ticks of all stretches."""
        return sum(stretch.n_ticks for stretch in self.stretches)


def plan_exact(
    log: Log,
    table: SignalTable,
    layout: Layout,
    base_period_ns: int,
    start: RecordedState | None = None,
) -> Plan:
    """Plan a replay that reproduces the bits of the recorded run.

    A snapshot `start` replaces the states of the recording. LogError if inputs are missing, or
    there is no initial state.
    """
    slots, values, status = _inputs(log, table)
    ticks = log.ticks(base_period_ns)
    stretches = []
    for first, last in _runs(log.segment, ticks):
        segment = int(log.segment[first])
        state = _state_in(log, segment, int(ticks[first]), int(ticks[last]), start)
        if state is None:
            continue
        begin = first + state.tick - int(ticks[first])
        part = slice(begin, last + 1)
        before = _frame_of(state.words, layout)
        rows = _changes(ticks[part], slots, values[part], status[part], before)
        span = segment, state.tick, int(ticks[last])
        changes = _changes_in(log, *span)
        faults = _faults_in(log, *span)
        n_ticks = last + 1 - begin
        stretches.append(
            Stretch(*span[:2], n_ticks, rows, state.words, changes, faults)
        )
        if start is not None:
            break
    if not stretches:
        raise _no_state(log, ticks, start)
    plan = Plan(stretches, feeds_state=True)
    if plan.n_ticks < len(log) and start is None:
        plan.notices.append(
            f"{log.path}: {len(log) - plan.n_ticks} of {len(log)} rows have no preceding state"
            " and are left out"
        )
    if forced := _forced(log, table):
        plan.notices.append(
            f"{log.path}: '{forced}' was forced (Force); a Force is no input, so the replay goes on"
            " without it, and what it changed differs"
        )
    return plan


def _forced(log: Log, table: SignalTable) -> str:
    """Return an output that was forced without a record of it; empty if there is none."""
    if (log.run or {}).get("faults"):
        return ""
    for name, codes in log.status.items():
        is_output = name in table and table[name].direction is Direction.OUT
        if is_output and (codes == GOOD_LOCAL_OVERRIDE).any():
            return name
    return ""


def _inputs(
    log: Log, table: SignalTable
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
    """Return the slots of all inputs, and their values and status codes by row."""
    known = log.columns
    inputs = [s for s in table.scalars if s.direction is Direction.IN]
    # Recordings of before a signal of the daemon existed are replayed without it.
    inputs = [s for s in inputs if not s.is_own or s.name in known]
    missing = [s.name for s in inputs if s.name not in known]
    if missing:
        raise LogError(
            f"{log.path}: was recorded without the input '{missing[0]}'; record all signals, or"
            " replay the inputs it has with --as-inputs"
        )
    if not len(log):
        raise LogError(f"{log.path}: contains no frames")
    values = np.stack([log.columns[s.name] for s in inputs], axis=1)
    if not log.status:
        status = np.full(values.shape, GOOD, dtype=np.int64)
    else:
        status = np.stack([log.status[s.name] for s in inputs], axis=1)
    return np.array([s.slots[0] for s in inputs]), values, status


def _runs(
    segment: NDArray[np.int64], ticks: NDArray[np.int64]
) -> list[tuple[int, int]]:
    """Return first and last row of every run of ticks without a gap."""
    breaks = (np.diff(ticks) != 1) | (np.diff(segment) != 0)
    cuts = np.flatnonzero(breaks) + 1
    firsts = [0, *cuts.tolist()]
    ends = [*firsts[1:], len(ticks)]
    return [(f, n - 1) for f, n in zip(firsts, ends, strict=True)]


def _state_in(
    log: Log, segment: int, low: int, high: int, start: RecordedState | None
) -> RecordedState | None:
    if start is not None:
        return start if low <= start.tick <= high else None
    fitting = [s for s in log.states if s.segment == segment and low <= s.tick <= high]
    return min(fitting, key=lambda s: s.tick, default=None)


def _changes_in(log: Log, segment: int, low: int, high: int) -> list[Change]:
    fitting = [c for c in log.changes if c.segment == segment and low <= c.tick <= high]
    return sorted(fitting, key=lambda change: change.tick)


def _faults_in(log: Log, segment: int, low: int, high: int) -> list[FaultCommand]:
    recorded = (log.run or {}).get("faults", ())
    commands = [FaultCommand.model_validate(command) for command in recorded]
    fitting = [c for c in commands if c.segment == segment and low <= c.tick <= high]
    return sorted(fitting, key=lambda command: command.tick)


def _no_state(
    log: Log, ticks: NDArray[np.int64], start: RecordedState | None
) -> LogError:
    if start is not None:
        return LogError(
            f"{log.path}: has no frame of tick {start.tick}, at which the snapshot was taken; it"
            f" covers ticks {ticks.min()} to {ticks.max()}"
        )
    return LogError(
        f"{log.path}: contains no state to start from; give a snapshot of its run with --from,"
        " or replay its set-points with --as-inputs"
    )


def _frame_of(
    state: NDArray[np.int64], layout: Layout
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return values and status codes of the frame in a state, shapes (n_slots,)."""
    live, frame, status = (layout.regions[name] for name in ("live", "frame", "status"))
    at_frame = frame.base - live.base
    at_status = status.base - live.base
    values = state[at_frame : at_frame + frame.length].view(np.float64)
    return values, state[at_status : at_status + status.length]


def _changes(
    ticks: NDArray[np.int64],
    slots: NDArray[np.int64],
    values: NDArray[np.float64],
    status: NDArray[np.int64],
    before: tuple[NDArray[np.float64], NDArray[np.int64]],
) -> NDArray[np.float64]:
    """Return a row for every input that differs from the tick before, bit by bit."""
    held = np.vstack([before[0][slots], values])
    codes = np.vstack([before[1][slots], status])
    # Each NaN becomes the value above it.
    for channel in np.flatnonzero(np.isnan(held).any(axis=0)):
        good = ~np.isnan(held[:, channel])
        last = np.maximum.accumulate(np.where(good, np.arange(len(held)), 0))
        held[:, channel] = held[last, channel]
    by_value = np.diff(held.view(np.int64), axis=0) != 0
    by_code = np.diff(codes, axis=0) != 0
    changed = by_value | by_code
    row, column = np.nonzero(changed)
    new_values = held[1:][row, column]
    new_codes = codes[1:][row, column]
    rows = np.column_stack([ticks[row], slots[column], new_values, new_codes])
    return rows.astype(np.float64)


def plan_inputs(log: Log, table: SignalTable, base_period_ns: int) -> Plan:
    """Plan a replay that holds the set-points of a log until its next row, from a fresh start.

    LogError if the log has no set-points, or would take forever.
    """
    names = [
        n
        for n in log.columns
        if n in table
        and table[n].writable
        and not table[n].is_measured
        and not table[n].is_array
    ]
    if not any(n in names for of_mode in OF_MODE for n in of_mode):
        raise LogError(
            f"{log.path}: has no column with set-points; known columns are wheel.fl.setpoint_rpm"
            " ...,"
            f" {', '.join(TWIST)} and wheel.fl.duty_command_pct ..."
        )
    if not len(log):
        raise LogError(f"{log.path}: contains no rows")
    plan = Plan([], feeds_state="internal.state" in names)
    mode = _mode(log, plan.notices)
    ticks = log.ticks(base_period_ns)
    clipped = {n: _clipped(log, table, n, plan.notices) for n in names}
    stretches = []
    for segment in dict.fromkeys(log.segment.tolist()):
        mask = log.segment == segment
        first = int(ticks[mask].min())
        last = int(ticks[mask].max())
        if last - first > MAX_TICKS:
            raise LogError(
                f"{log.path}: segment {segment} lasts more than {MAX_TICKS} ticks"
            )
        parts = [_rows(ticks[mask], table.slot(n), clipped[n][mask]) for n in names]
        if mode:
            parts.append(np.array([[first, table.slot(MODE), mode, GOOD]]))
        rows = np.concatenate(parts)
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
        stretches.append(Stretch(segment, first, last - first + 1, rows))
    return Plan(stretches, plan.feeds_state, plan.notices)


def _mode(log: Log, notices: list[str]) -> int:
    """Return the initial mode; add notices on set-points without effect."""
    used = {n for n, values in log.columns.items() if np.isfinite(values).any()}
    given = [mode for mode, names in enumerate(OF_MODE) if used & set(names)]
    if MODE in used:
        modes = log.columns[MODE]
        first = 0
        in_force = set(modes[np.isfinite(modes)].tolist())
    else:
        first = given[0] if given else 0
        in_force = {first}
    idle = sorted(
        n for mode in given if mode not in in_force for n in used & set(OF_MODE[mode])
    )
    if idle:
        shown = " or ".join(f"{mode:g}" for mode in sorted(in_force))
        notices.append(
            f"{log.path}: {', '.join(idle)} without effect: {MODE} is {shown} throughout;"
            " record or map it, or leave the others out"
        )
    is_off = ENABLE in used and not np.nan_to_num(log.columns[ENABLE]).any()
    if is_off or not any(mode in in_force for mode in given):
        why = f"{ENABLE} is 0 throughout" if is_off else "no set-point is in force"
        notices.append(f"{log.path}: none of its columns moves the robot: {why}")
    return first


def _rows(
    ticks: NDArray[np.int64], slot: int, values: NDArray[np.float64]
) -> NDArray[np.float64]:
    good = ~np.isnan(values)
    rows = np.empty((int(good.sum()), 4))
    rows[:, 0] = ticks[good]
    rows[:, 1] = slot
    rows[:, 2] = values[good]
    rows[:, 3] = GOOD
    return rows


def _clipped(
    log: Log, table: SignalTable, name: str, notices: list[str]
) -> NDArray[np.float64]:
    signal = table[name]
    values = log.columns[name]
    limited = np.clip(values, signal.low, signal.high)
    outside = int((limited != values)[~np.isnan(values)].sum())
    if outside:
        notices.append(
            f"{log.path}: column '{name}': {outside} values outside {signal.low:g} .."
            f" {signal.high:g} {signal.unit} were limited"
        )
    return limited

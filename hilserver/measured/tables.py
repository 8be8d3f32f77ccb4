"""Files to tables: CSV, our recordings and Parquet, with our names or through a mapping."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml

from hilserver.arrays import Array, Indices
from hilserver.errors import LogError, meant, nearest
from hilserver.logs import Log, read_log
from hilserver.logs.csv_layout import CsvLayout, read_layout
from hilserver.logs.csv_reader import NO_NAME, read_table
from hilserver.logs.csv_times import kind_of
from hilserver.logs.csv_writer import meta_path
from hilserver.logs.provenance import configuration_of
from hilserver.logs.table import BLOCK, SEGMENT, TIME, Table, in_time
from hilserver.measured.candidates import has_wheels
from hilserver.measured.evidence import table_samples
from hilserver.measured.frames import (
    Sampling,
    frames_of,
    is_of_the_daemon,
    own_sampling,
)
from hilserver.measured.mapping import DATED, PER_SECOND, LogMapping
from hilserver.measured.names import (
    conversion,
    known_columns,
    known_signals,
    mapped_units,
    unit_in_name,
    unit_in_text,
)
from hilserver.measured.other_machines import refuse_other_machine
from hilserver.measured.parquet import parquet_samples, read_parquet
from hilserver.measured.proposal import (
    ForeignLog,
    Head,
    candidates_of,
    propose,
    time_column,
)
from hilserver.measured.stamps import columns_of, refuse_coarse, times_of
from hilserver.measured.thresholds import ABSURD


@dataclass(frozen=True)
class Stamped:
    """Signals with common stamps; NaN where there is no sample."""

    # shape (n,)
    t_s: Array
    segment: Indices
    columns: Mapping[str, Array]  # shape (n,): by signal name
    block: Indices | None = None
    # shape (n,): how long before its row a sample was taken; 0 if the key is missing
    age_s: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Recording:
    """What one file holds."""

    path: Path
    parts: Sequence[Stamped]
    has_stamps: bool = True
    notices: Sequence[str] = ()
    machine: str | None = None  # the plant with which our recording was made, as YAML
    on_ticks: bool = False  # see `MeasuredLog`
    by_satellites: bool = False  # the position was made of fixes


def read_own(path: Path, sampling: Sampling | None = None) -> Recording:
    """Read a table whose columns are signal names: CSV, or one of our recordings.

    `sampling` is for frames that do not carry their daemon's configuration.
    """
    log = read_log(path, known_columns())
    for name, values in log.columns.items():
        refuse_absurd(
            values, name, lambda row, name: f"{path}: row {row + 2}, column '{name}'"
        )
    return _own(log, sampling)


def refuse_foreign(path: Path) -> None:
    """Refuse a table with columns that are no signals, with a mapping file that may fit it."""
    if path.suffix == ".parquet":
        header, of_columns, types = parquet_samples(path)
        head = Head(header, (), of_columns, types)
    elif path.suffix == ".csv" and not meta_path(path).exists():
        layout = read_layout(path)
        first = "" if layout is None else next(iter(layout.header), NO_NAME[0])
        if layout is None or first.startswith((*NO_NAME, "\0")):
            return  # the reader will report it
        _refuse_units(path, layout)
        time = time_column(layout.header, {}, layout.first)
        numbers = table_samples(path, layout, time)
        units = dict(zip(layout.header, layout.units, strict=False))
        head = Head(layout.header, layout.first, numbers, {}, units, layout.header_row)
    else:
        return
    known = (*known_columns(), TIME, SEGMENT, BLOCK)
    others = [name for name in head.header if name and name not in known]
    is_ours = not {*known_columns(), BLOCK, SEGMENT}.isdisjoint(head.header)
    has_names = any(kind_of(name) == "" for name in others)
    if not has_names and (others or is_ours):
        return  # all is known, or there is no header, which the reader will report
    if others:
        _refuse(path, head, others, is_ours=is_ours)


def _refuse(path: Path, head: Head, others: Sequence[str], *, is_ours: bool) -> None:
    """Refuse a table with the columns `others`, which are no signals."""
    at = f"{path}: row {head.row}"
    found = candidates_of(head)
    seen = [n for n in others if n not in head.numbers or head.numbers[n].moves]
    joints = [text for text in head.first if text and not kind_of(text)]
    refuse_other_machine(at, [*seen, *joints], (), has_wheels=has_wheels(found))
    proposal = propose(head)
    if not proposal and TIME in head.header:
        return  # the reader names the first of them, and what may be meant
    columns = ", ".join(f"'{name}'" for name in others)
    remedy = "name them in a mapping file and give it with --mapping"
    near = next((n for n in others if "." in n and nearest(n, known_columns())), None)
    if near is not None:
        place = f"column {head.header.index(near) + 1} '{near:.60}'"
        hint = meant(near, known_columns(), "")
        what = f"{at}, {place}: there is no such signal; {hint} Else {remedy}"
    elif is_ours and TIME not in head.header:
        what = (
            f"{at}: there is no column '{TIME}'; give the time column this name, in s, or map it"
            " with --mapping"
        )
    elif is_ours:
        what = f"{at}: the columns {columns:.600} are no hilserver signals; {remedy}"
    else:
        what = (
            f"{at}: none of the columns {columns:.600} is a hilserver signal; {remedy}"
        )
    raise ForeignLog(what, proposal)


def _refuse_units(path: Path, layout: CsvLayout) -> None:
    """Refuse a row of units that contradicts the names of our signals."""
    for name in known_signals().keys() & set(layout.header):
        wanted = mapped_units()[name]
        said = unit_in_text(layout.unit(name), wanted)
        if said not in (None, wanted):
            raise LogError(
                f"{path}: column '{name}': the row of units says {said}, the name {wanted};"
                " correct the one that is wrong, or give the column another name and map it"
            )


def _own(log: Log, sampling: Sampling | None) -> Recording:
    is_ours = is_of_the_daemon(log)
    frames = frames_of(log, own_sampling(log) or sampling if is_ours else None)
    part = Stamped(log.t_s, frames.segment, frames.columns, log.block, frames.age_s)

    machine: str | None = None
    try:
        configuration = configuration_of(log.run)
        sections = {key: configuration[key] for key in ("plant", "kinematics")}
        machine = yaml.safe_dump(sections)
    except (ValueError, KeyError):
        pass  # it does not say with which plant it was made
    notices = list(log.notices)
    return Recording(
        log.path, [part], notices=notices, machine=machine, on_ticks=frames.on_ticks
    )


def log_of_parquet(path: Path) -> tuple[Log, Table]:
    """Return a Parquet table as a log, and its rows, whose places complaints name."""
    table = read_parquet(path, time=TIME)
    if TIME not in table.header:
        raise LogError(
            f"{path}: there is no column 't_s'; give the time column this name, in s, or map it"
            " with --mapping"
        )
    names = [name for name in table.header if name not in (TIME, SEGMENT, BLOCK)]
    table = in_time(table, TIME)
    columns = {name: table.column(name) for name in names}
    block = table.integers(BLOCK)
    t_s = table.column(TIME) * PER_SECOND[table.units.get(TIME, "s")]
    log = Log(path, t_s, table.segment(), columns, block, notices=table.notices)
    return log, table


def read_own_parquet(path: Path, sampling: Sampling | None = None) -> Recording:
    """Read a Parquet table whose columns are signal names; see `read_own`."""
    log, table = log_of_parquet(path)
    known = (*known_columns(), TIME, SEGMENT, BLOCK)
    for name, values in log.columns.items():
        if name not in known:
            hint = meant(name, known, "see 'hilserver signals' for the names")
            raise LogError(f"{path}: column '{name}': there is no such signal; {hint}")
        refuse_absurd(values, name, table.where)
    return _own(log, sampling)


def read_mapped(path: Path, mapping: LogMapping) -> Recording:
    """Read a foreign table, CSV or Parquet, through a mapping."""
    time = None if mapping.time.rate_hz else mapping.time.column or TIME
    segment = SEGMENT if mapping.segment is None else mapping.segment.column
    block = BLOCK if mapping.block is None else mapping.block.column
    is_parquet = path.suffix == ".parquet"
    layout = None if is_parquet else read_layout(path)
    header = read_parquet(path, ()).header if is_parquet else []
    if layout is not None:
        header = layout.header
    first = () if layout is None else layout.first
    stamps = columns_of(time or "", mapping.time.rest, header, first)

    used = {str(channel.column) for channel in mapping.channels.values()}
    used |= {segment, block} | {n for n in (time, stamps.rest) if n is not None}
    if is_parquet:
        table = read_parquet(path, used, time)
    else:
        is_dated = mapping.time.unit == DATED
        table = read_table(
            path,
            time=time,
            used=used,
            rest=stamps.rest,
            layout=layout,
            dated=is_dated,
        )
    demanded = {"time": time, "time.rest": stamps.rest}
    demanded[SEGMENT] = segment if mapping.segment is not None else None
    demanded[BLOCK] = block if mapping.block is not None else None
    for key, column in demanded.items():
        if column is not None:
            _demand(table, column, key)
    if time is not None:
        table, per_second = times_of(table, stamps, mapping.time)
        rows = len(table.lines)
        table = in_time(table, time, segment, block)
        refuse_coarse(path, time, rows, table)
        t_s = table.column(time) * per_second
    else:
        t_s = _counted(table.segment(segment), float(mapping.time.rate_hz or 1.0))
    notices = list(table.notices)
    columns = {}
    for name, channel in mapping.channels.items():
        if not channel.optional or channel.column in table.header:
            columns[name] = _mapped(table, mapping, name, notices)
    part = Stamped(t_s, table.segment(segment), columns, table.integers(block))
    return Recording(path, [part], time is not None, list(dict.fromkeys(notices)))


def _counted(segment: Indices, rate_hz: float) -> Array:
    """Return the times of rows at a constant rate."""
    starts = np.flatnonzero(np.diff(segment, prepend=segment[:1] - 1))
    n = len(segment)
    row = np.arange(n) - np.repeat(starts, np.diff(starts, append=n))
    return np.divide(row, rate_hz, dtype=np.float64)


def _demand(table: Table, column: str, key: str) -> None:
    if column not in table.header:
        known = f"the columns are {', '.join(table.header):.200}"
        hint = meant(column, table.header, known)
        raise LogError(
            f"{table.path}: row {table.header_row}: there is no column '{column}', which the"
            f" mapping names for {key}; {hint}"
        )


def _mapped(table: Table, mapping: LogMapping, name: str, notices: list[str]) -> Array:
    """Return a column as a signal, in the unit that the mapping, else the file says."""
    channel = mapping.channels[name]
    wanted = mapped_units()[name]
    column = str(channel.column)
    _demand(table, column, name)
    in_row = unit_in_text(table.units.get(column, ""), wanted)
    said = in_row or unit_in_name(column, wanted)
    if channel.unit is None and channel.scale is None and said not in (None, wanted):
        notices.append(
            f"{table.path}: column '{column}' is read in {said}, as the file says"
        )
    elif channel.unit is None or in_row is None:
        pass
    elif conversion(channel.unit, in_row) not in (1.0, None):
        notices.append(
            f"{table.path}: column '{column}' is read in {channel.unit}, as the mapping says,"
            f" though its row of units says {in_row}"
        )
    values = table.column(column)
    return as_signal(mapping, name, values, column, table.where, said)


def as_signal(
    mapping: LogMapping,
    name: str,
    values: Array,
    at: str,
    where: Callable[[int, str], str],
    said: str | None = None,
) -> Array:
    """Return the numbers of a foreign log as a signal; LogError if one is impossibly large.

    `said`: the unit that the file says, for a channel without one.
    """
    refuse_absurd(values, at, where)
    with np.errstate(over="ignore"):
        scaled = values * mapping.factor(name, said)
        converted: Array = scaled + mapping.channels[name].offset
    refuse_absurd(converted, at, lambda row, at: f"{where(row, at)}, as {name}")
    return converted


def refuse_absurd(values: Array, name: str, where: Callable[[int, str], str]) -> None:
    """Refuse infinite and impossibly large values; `where` names the place of a row and `name`."""
    wrong = np.flatnonzero(np.abs(values) > ABSURD)
    if wrong.size:
        row = int(wrong[0])
        raise LogError(
            f"{where(row, name)}: {float(values[row]):g} is not a possible value for a robot;"
            " write a finite number or nothing"
        )

"""Files to tables: CSV, our recordings and Parquet, with our names or through a mapping."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml

from hilserver.arrays import Array, Indices
from hilserver.errors import LogError, meant, nearest
from hilserver.logs import Log, read_log
from hilserver.logs.csv_dialects import separator_of
from hilserver.logs.csv_reader import NO_NAME, read_table
from hilserver.logs.provenance import configuration_of
from hilserver.logs.table import BLOCK, SEGMENT, TIME, Table, in_time
from hilserver.measured.frames import (
    Sampling,
    frames_of,
    is_of_the_daemon,
    own_sampling,
)
from hilserver.measured.mapping import DATED, PER_SECOND, LogMapping
from hilserver.measured.names import known_columns
from hilserver.measured.parquet import read_parquet
from hilserver.measured.proposal import ForeignLog, propose
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
    """Refuse a table without any signal as a column, with a mapping file that may fit it."""
    if path.suffix == ".parquet":
        header, first = read_parquet(path, ()).header, []
    elif path.suffix == ".csv":
        with path.open("rb") as file:
            rows = file.readline(1 << 20), file.readline(1 << 20)
        try:
            texts = [row.decode("utf-8-sig").rstrip("\r\n") for row in rows]
        except UnicodeDecodeError:
            return  # the reader will report it
        separator = separator_of(texts[0])
        header, first = (
            [text.strip().strip('"') for text in row.split(separator)] for row in texts
        )
    else:
        return
    if header[0].startswith(NO_NAME):
        return  # the reader will report it
    is_misspelt = any("." in name and nearest(name, known_columns()) for name in header)
    if not is_misspelt and {*known_columns(), BLOCK, SEGMENT}.isdisjoint(header):
        columns = ", ".join(f"'{name}'" for name in header)
        if proposal := propose(header, first):  # else the reader will report the error
            raise ForeignLog(
                f"{path}: row 1: none of the columns {columns:.600} is a hilserver signal; name"
                " them in a mapping file and give it with --mapping",
                proposal,
            )


def _machine(log: Log) -> str | None:
    try:
        configuration = configuration_of(log.run)
        sections = {key: configuration[key] for key in ("plant", "kinematics")}
    except (ValueError, KeyError):
        return None
    return yaml.safe_dump(sections)


def _own(log: Log, sampling: Sampling | None) -> Recording:
    frames = frames_of(
        log, own_sampling(log) or sampling if is_of_the_daemon(log) else None
    )
    part = Stamped(log.t_s, frames.segment, frames.columns, log.block, frames.age_s)
    return Recording(
        log.path,
        [part],
        notices=list(log.notices),
        machine=_machine(log),
        on_ticks=frames.on_ticks,
    )


def log_of_parquet(path: Path) -> tuple[Log, Table]:
    """Return a Parquet table as a log, and its rows, whose places complaints name."""
    table = read_parquet(path)
    if TIME not in table.header:
        raise LogError(
            f"{path}: there is no column 't_s'; give the time column this name, in s, or map it"
            " with --mapping"
        )
    names = [name for name in table.header if name not in (TIME, SEGMENT, BLOCK)]
    table = in_time(table, TIME)
    columns = {name: table.column(name) for name in names}
    block = table.integers(BLOCK)
    log = Log(
        path, table.column(TIME), table.segment(), columns, block, notices=table.notices
    )
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
    segment, block = (
        default if named is None else named.column
        for named, default in ((mapping.segment, SEGMENT), (mapping.block, BLOCK))
    )
    used = {str(channel.column) for channel in mapping.channels.values()}
    used |= {segment, block, *([] if time is None else [time])}
    is_parquet = path.suffix == ".parquet"
    dated = mapping.time.unit == DATED and time is not None
    if is_parquet and dated:
        raise LogError(
            f"{path}: Parquet has numbers or time stamps but no dates; give their unit, as"
            " time: {unit: us}"
        )
    table = (
        read_parquet(path, used)
        if is_parquet
        else read_table(path, time=time, used=used, dated=dated)
    )
    for key, column, is_named in (
        ("time", str(time), time is not None),
        (SEGMENT, segment, mapping.segment is not None),
        (BLOCK, block, mapping.block is not None),
    ):
        if is_named:
            _demand(table, column, key)
    if time is not None:
        table = in_time(table, time, segment, block)
        t_s = table.column(time) * PER_SECOND[mapping.time.unit]
    else:
        t_s = _counted(table.segment(segment), float(mapping.time.rate_hz or 1.0))
    columns = {
        name: _mapped(table, mapping, name)
        for name, channel in mapping.channels.items()
        if not channel.optional or channel.column in table.header
    }
    part = Stamped(t_s, table.segment(segment), columns, table.integers(block))
    return Recording(path, [part], time is not None, table.notices)


def _counted(segment: Indices, rate_hz: float) -> Array:
    """Return the times of rows at a constant rate."""
    starts = np.flatnonzero(np.diff(segment, prepend=segment[:1] - 1))
    n = len(segment)
    row = np.arange(n) - np.repeat(starts, np.diff(starts, append=n))
    return np.divide(row, rate_hz, dtype=np.float64)


def _demand(table: Table, column: str, key: str) -> None:
    if column not in table.header:
        hint = meant(
            column, table.header, f"the columns are {', '.join(table.header):.200}"
        )
        raise LogError(
            f"{table.path}: row 1: there is no column '{column}', which the mapping names for"
            f" {key}; {hint}"
        )


def _mapped(table: Table, mapping: LogMapping, name: str) -> Array:
    column = str(mapping.channels[name].column)
    _demand(table, column, name)
    return as_signal(mapping, name, table.column(column), column, table.where)


def as_signal(
    mapping: LogMapping,
    name: str,
    values: Array,
    at: str,
    where: Callable[[int, str], str],
) -> Array:
    """Return the numbers of a foreign log as a signal; LogError if one is impossibly large."""
    refuse_absurd(values, at, where)
    with np.errstate(over="ignore"):
        converted: Array = values * mapping.factor(name) + mapping.channels[name].offset
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

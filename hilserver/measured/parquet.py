"""Parquet tables, if the library for them is installed."""

import contextlib
from collections.abc import Container
from pathlib import Path
from typing import Any

import numpy as np

from hilserver.arrays import Array
from hilserver.errors import LogError
from hilserver.logs.csv_times import stamp_ns
from hilserver.logs.table import EXACT, Table
from hilserver.logs.unpacking import Budget
from hilserver.measured.evidence import MOST_ROWS, Samples, samples


def read_parquet(
    path: Path, used: Container[str] | None = None, time: str | None = None
) -> Table:
    """Read the numbers of a Parquet file; rows are counted from 1.

    Time stamps, durations and times of day are whole numbers of the unit of their type, dates
    as text nanoseconds. `time` is the column of the stamps.

    Raises
    ------
    LogError
        If pyarrow is not installed, the file is damaged or too large, or a column holds no
        numbers.
    """
    try:
        from pyarrow import ArrowException, parquet, types  # noqa: PLC0415 -- an extra
    except ImportError:
        raise LogError(
            f"{path}: Parquet needs the library pyarrow; install it with"
            " \"pip install 'hilserver[parquet]'\", or save the table as CSV"
        ) from None
    path.open("rb").close()  # the system's own message if it cannot be opened
    budget = Budget(path)
    try:
        with parquet.ParquetFile(path) as file:
            header = file.schema_arrow.names
            read = [i for i, name in enumerate(header) if used is None or name in used]
            names = [header[i] for i in read]
            budget.take(file.metadata.num_rows * len(names) * 8)
            table = file.read(columns=names)
    except (ArrowException, OSError) as error:
        reason = str(error).split(". ")[0].splitlines()[0]
        raise LogError(f"{path}: not a readable Parquet file: {reason:.120}") from None
    found = [_numbers(path, name, table.column(i)) for i, name in enumerate(names)]
    columns, units, origins = zip(*found, strict=True) if found else ((), (), ())
    rows = np.stack(columns, axis=1) if columns else np.empty((0, 0))
    result = Table(path, header, rows.reshape(-1), range(1, len(rows) + 1), read=read)
    result.units = {n: unit for n, unit in zip(names, units, strict=True) if unit}
    if time in result.units:
        kind = table.schema.field(time).type
        is_duration = types.is_duration(kind) or types.is_time(kind)
        result.stamps = "durations" if is_duration else "moments"
    result.origin = dict(zip(names, origins, strict=True)).get(str(time), 0)
    return result


def parquet_samples(
    path: Path,
) -> tuple[list[str], dict[str, Samples], dict[str, str]]:
    """Return header, numbers of the columns, and the units of those that are times by type.

    LogError as in `read_parquet`.
    """
    header = read_parquet(path, ()).header
    tables = {}
    for name in header:
        with contextlib.suppress(LogError):  # no numbers
            tables[name] = read_parquet(path, (name,), name)
    typed = {name: table.units[name] for name, table in tables.items() if table.units}
    n = max((len(table.lines) for table in tables.values()), default=0)
    t = np.arange(n, dtype=np.float64)
    for name in typed:
        t = tables[name].column(name)
        break
    step = max(1, n // MOST_ROWS)
    found = {
        name: samples(t[::step], table.column(name)[::step])
        for name, table in tables.items()
    }
    return header, found, typed


def _numbers(path: Path, name: str, column: Any) -> tuple[Array, str, int]:
    """Return a column as doubles, the unit that its type says, and what they count from.

    Whole numbers too long for doubles count from the first one.
    """
    from pyarrow import (  # noqa: PLC0415 -- an extra
        ArrowException,
        array,
        chunked_array,
        types,
    )

    kind = column.type
    unit = ""
    try:
        if types.is_timestamp(kind) or types.is_duration(kind) or types.is_time(kind):
            unit = kind.unit
            column = column.cast("int32" if types.is_time32(kind) else "int64")
        elif types.is_date(kind):
            unit, column = "ms", column.cast("date64").cast("int64")
        elif types.is_string(kind) or types.is_large_string(kind):
            first = next(iter(column.slice(0, 1).to_pylist()), None) or ""
            texts = column.to_pylist() if stamp_ns(first) is not None else []
            stamps = [stamp_ns(text or "") for text in texts]
            if stamps and None not in stamps:
                unit, column = "ns", chunked_array([array(stamps, "int64")])
        if types.is_integer(column.type) and not column.null_count:
            whole = column.to_numpy()
            if len(whole) and abs(int(whole[0])) >= EXACT:
                origin = int(whole[0])
                return np.asarray(whole - whole[0], dtype=np.float64), unit, origin
        converted = column.cast("float64", safe=False)
        return np.asarray(converted.to_numpy(), dtype=np.float64), unit, 0
    except (ArrowException, ValueError):
        raise LogError(
            f"{path}: column '{name}' contains no numbers; leave it out"
        ) from None

"""Parquet tables, if the library for them is installed."""

from collections.abc import Container
from pathlib import Path
from typing import Any

import numpy as np

from hilserver.arrays import Array
from hilserver.errors import LogError
from hilserver.logs.table import EXACT, Table
from hilserver.logs.unpacking import Budget


def read_parquet(path: Path, used: Container[str] | None = None) -> Table:
    """Read the numbers of a Parquet file; rows are counted from 1.

    Raises
    ------
    LogError
        If pyarrow is not installed, the file is damaged or too large, or a column holds no
        numbers.
    """
    try:
        from pyarrow import ArrowException, parquet  # noqa: PLC0415 -- an extra
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
    columns = [_numbers(path, name, table.column(i)) for i, name in enumerate(names)]
    numbers = np.stack(columns, axis=1) if columns else np.empty((0, 0))
    return Table(
        path, header, numbers.reshape(-1), range(1, len(numbers) + 1), read=read
    )


def _numbers(path: Path, name: str, column: Any) -> Array:
    """Return a column as doubles; whole numbers too long for them count from the first one."""
    from pyarrow import ArrowException, types  # noqa: PLC0415 -- an extra

    try:
        if types.is_timestamp(column.type):
            column = column.cast("int64")
        if types.is_integer(column.type) and not column.null_count:
            whole = column.to_numpy()
            if len(whole) and abs(int(whole[0])) >= EXACT:
                return np.asarray(whole - whole[0], dtype=np.float64)
        converted = column.cast("float64", safe=False)
        return np.asarray(converted.to_numpy(), dtype=np.float64)
    except (ArrowException, ValueError):
        raise LogError(
            f"{path}: column '{name}' contains no numbers; leave it out"
        ) from None

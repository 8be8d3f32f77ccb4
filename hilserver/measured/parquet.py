"""Parquet tables, where the library for them is installed."""

from pathlib import Path

import numpy as np

from hilserver.errors import LogError
from hilserver.logs.csv_reader import Table


def read_parquet(path: Path) -> Table:
    """Read the numbers of a Parquet file; rows are counted from 1.

    Raises
    ------
    LogError
        When pyarrow is not installed, the file is damaged, or a column holds no numbers.
    """
    try:
        from pyarrow import ArrowException, parquet  # noqa: PLC0415 -- an extra
    except ImportError:
        raise LogError(
            f"{path}: Parquet needs the library pyarrow; install it with"
            " \"pip install 'hilserver[parquet]'\", or save the table as CSV"
        ) from None
    path.open("rb").close()  # the system's own words for what cannot be opened
    try:
        table = parquet.read_table(path)
    except (ArrowException, OSError) as error:
        reason = str(error).split(". ")[0].splitlines()[0]
        raise LogError(f"{path}: is no readable Parquet file: {reason:.120}") from None
    columns = []
    for name in table.column_names:
        try:
            column = table[name].cast("float64", safe=False)
            columns.append(column.to_numpy(zero_copy_only=False).astype(np.float64))
        except (ArrowException, ValueError):
            raise LogError(f"{path}: column '{name}' holds no numbers; leave it out") from None
    numbers = np.stack(columns, axis=1) if columns else np.empty((0, 0))
    return Table(path, list(table.column_names), numbers.reshape(-1), range(1, len(numbers) + 1))

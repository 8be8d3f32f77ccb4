"""Any log that can be read as one table, for `hilserver convert`."""

from pathlib import Path

import numpy as np

from hilserver.errors import LogError
from hilserver.logs import Log, read_log
from hilserver.logs.bag_reader import is_own_bag
from hilserver.logs.reading import is_bag_of_ros, refuse_others
from hilserver.logs.rewriting import as_table
from hilserver.measured.bag import read_bag
from hilserver.measured.bag_proposal import refuse_unmapped
from hilserver.measured.fixes import placed
from hilserver.measured.mapping import load_mapping
from hilserver.measured.names import known_columns
from hilserver.measured.tables import Recording, log_of_parquet, read_mapped


def read_any(path: Path, mapping: str | None = None) -> Log:
    """Read a log of any kind, or raise LogError; through a mapping its channels become signals."""
    refuse_others(path)
    try:
        if mapping is not None:
            table = load_mapping(mapping)
            read = read_bag if table.is_for_bags else read_mapped
            (recording,) = placed([read(path, table)])
            return _one_table(recording)
        if path.suffix == ".parquet":
            return log_of_parquet(path)[0]
        if is_bag_of_ros(path) and not is_own_bag(path):
            refuse_unmapped(path)
        return read_log(path, known_columns())
    except OSError as error:
        reason = error.strerror or "cannot be read"
        raise LogError(f"{path}: {reason.lower()}") from None


def _one_table(recording: Recording) -> Log:
    """Return the parts of a recording as one table; empty where a part has no sample."""
    if len(recording.parts) == 1:
        (part,) = recording.parts
        columns = dict(part.columns)
        return Log(
            recording.path,
            part.t_s,
            part.segment,
            columns,
            part.block,
            notices=recording.notices,
        )
    t_s = np.unique(np.concatenate([part.t_s for part in recording.parts]))
    columns = {}
    for part in recording.parts:
        rows = np.searchsorted(t_s, part.t_s)
        for name, values in part.columns.items():
            columns[name] = np.full(len(t_s), np.nan)
            columns[name][rows] = values
    segment = np.zeros(len(t_s), dtype=np.int64)
    return Log(recording.path, t_s, segment, columns, notices=recording.notices)


def write_parquet(log: Log, path: Path) -> None:
    """Write a log as Parquet; LogError if pyarrow is not installed."""
    try:
        import pyarrow as pa  # noqa: PLC0415 -- an extra
        from pyarrow import parquet  # noqa: PLC0415
    except ImportError:
        raise LogError(
            f"{path}: Parquet needs the library pyarrow; install it with"
            " \"pip install 'hilserver[parquet]'\", or write CSV"
        ) from None
    parquet.write_table(pa.table(as_table(log)), path)

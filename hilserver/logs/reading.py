"""Reading logs of any accepted kind; every complaint is one sentence with file, row and remedy."""

from collections.abc import Container
from pathlib import Path

from hilserver.errors import LogError
from hilserver.logs.csv_reader import read_csv
from hilserver.logs.log import Log
from hilserver.logs.mcap_reader import read_mcap


def read_log(path: Path, known: Container[str] | None = None) -> Log:
    """Read a log.

    Parameters
    ----------
    known : container of str, optional
        Signals that a log of others may have as columns; None: any name.

    Raises
    ------
    LogError
        One sentence that names file, row, column and remedy.
    """
    refuse_endless(path)
    try:
        if path.suffix == ".mcap":
            return read_mcap(path)
        if path.suffix == ".csv":
            return read_csv(path, known)
    except OSError as error:
        raise LogError(f"{path}: {(error.strerror or 'cannot be read').lower()}") from None
    raise LogError(f"{path}: is no log that can be read; known are .csv and .mcap")


def refuse_endless(path: Path) -> None:
    """Refuse devices and pipes, which may never end.

    Raises
    ------
    LogError
    """
    if path.exists() and not path.is_file() and not path.is_dir():
        raise LogError(f"{path}: is a device or a pipe, not a file; save the log as a file first")

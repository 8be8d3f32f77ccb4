"""Reading logs of any accepted kind; every complaint is one sentence with file, row and remedy."""

from collections.abc import Container, Iterator
from pathlib import Path

from hilserver.errors import LogError
from hilserver.logs.bag_messages import PACKED
from hilserver.logs.bag_reader import read_own_bag
from hilserver.logs.csv_reader import read_csv
from hilserver.logs.log import Log
from hilserver.logs.mcap_reader import read_mcap, read_mcap_pieces
from hilserver.logs.mf4 import read_mf4

ROS2_BEGINNING = b"\x89MCAP0\r\n\x01" + bytes(8) + b"\x04\x00\x00\x00ros2"
"""Beginning of a file; the eight bytes are the length of its header."""
ROS1_BEGINNING = b"#ROSBAG V"


def read_log(path: Path, known: Container[str] | None = None) -> Log:
    """Read a log; a foreign one may have the columns `known`. LogError names file and row."""
    refuse_others(path)
    try:
        if is_bag_of_ros(path):
            return read_own_bag(path)
        if path.suffix == ".mcap":
            return read_mcap(path)
        if path.suffix == ".csv":
            return read_csv(path, known)
        if path.suffix == ".mf4":
            return read_mf4(path)
    except OSError as error:
        raise LogError(
            f"{path}: {(error.strerror or 'cannot be read').lower()}"
        ) from None
    if not path.exists():
        raise LogError(f"{path}: no such file or folder")
    raise LogError(
        f"{path}: not a readable log; supported are .csv, .mcap, bags and .mf4; a table of text"
        " is read as well if its name ends in .csv"
    )


def read_pieces(path: Path) -> Iterator[Log]:
    """Yield a log in pieces, in order; LogError as in `read_log`.

    Only our own recordings have several; any other log comes whole.
    """
    refuse_others(path)
    if path.suffix != ".mcap" or is_bag_of_ros(path):
        yield read_log(path)
        return
    try:
        yield from read_mcap_pieces(path)
    except OSError as error:
        raise LogError(
            f"{path}: {(error.strerror or 'cannot be read').lower()}"
        ) from None


def is_bag_of_ros(path: Path) -> bool:
    """Return whether a path is a bag: a folder, sqlite3, or MCAP with the profile of ROS 2."""
    if path.is_dir() or path.name.endswith((".db3", *PACKED)):
        return True
    if path.suffix != ".mcap" or not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(ROS2_BEGINNING)).endswith(ROS2_BEGINNING[-8:])


def refuse_others(path: Path) -> None:
    """Refuse missing files, devices and pipes, which may never end, and bags of ROS 1."""
    try:
        path.stat()
    except OSError as error:
        raise LogError(
            f"{path}: {(error.strerror or 'cannot be read').lower()}"
        ) from None
    if not path.is_file() and not path.is_dir():
        raise LogError(
            f"{path}: is a device or pipe, not a file; save the log to a file first"
        )
    if path.is_file():
        with path.open("rb") as file:
            is_ros1 = file.read(len(ROS1_BEGINNING)) == ROS1_BEGINNING
        if is_ros1:
            raise LogError(
                f"{path}: is a ROS 1 bag; convert it with 'rosbags-convert --src {path.name}"
                f" --dst {path.stem}' and read the folder {path.stem}"
            )

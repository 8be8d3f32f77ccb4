"""The disk of simulated hours loses what a real one may lose, and no more."""

import errno
import os
import random

import pytest

from tests.hours.disk import FULL, SHORT, Disk


@pytest.fixture(params=range(10))
def disk(tmp_path, request):
    (tmp_path / "disk").mkdir()
    disk = Disk(tmp_path / "disk", tmp_path / "after", random.Random(request.param))
    disk._calls_left = 0  # loses its power when it is told to
    return disk


def written(disk, name, *parts, synced=0):
    """Write parts, of which so many are handed to the disk."""
    fd = os.open(disk.folder / name, os.O_RDWR | os.O_CREAT)
    for number, part in enumerate(parts):
        left = part
        while left:
            left = left[disk.write(fd, left) :]
        if number < synced:
            disk.sync(fd)
    os.close(fd)
    return disk.folder / name


def test_what_was_synced_is_there_and_of_the_rest_a_part(disk):
    written(disk, "a", b"safe", b"perhaps", synced=1)
    disk.lose_power()
    left = (disk.after / "a").read_bytes()
    assert left.startswith(b"safe")
    assert b"safeperhaps".startswith(left)


def test_a_name_stands_for_the_file_before_or_for_the_new_one(disk):
    written(disk, "a", b"old", synced=1)
    disk.replace(written(disk, "b", b"newer", synced=1), disk.folder / "a")
    disk.lose_power()
    assert (disk.after / "a").read_bytes() in (b"old", b"newer")


def test_a_new_name_is_there_once_its_folder_was_synced(disk):
    disk.replace(written(disk, "part", b"new", synced=1), disk.folder / "a")
    is_safe = disk.chance.random() < 0.5
    if is_safe:
        fd = os.open(disk.folder, os.O_RDONLY)
        disk.sync(fd)
        os.close(fd)
    disk.lose_power()
    assert not is_safe or (disk.after / "a").read_bytes() == b"new"


def test_short_writes_lose_nothing_and_a_full_disk_takes_a_part(disk):
    disk.trouble = SHORT
    assert written(disk, "a", 9 * b"short").read_bytes() == 9 * b"short"
    disk.trouble = FULL
    with pytest.raises(OSError, match=os.strerror(errno.ENOSPC)):
        written(disk, "b", *50 * [b"full"])
    assert len((disk.folder / "b").read_bytes()) < 50 * len(b"full")

"""A disk that fails, and what it holds after the computer lost its power.

Files below one folder are real ones. Writes to them may be short, or end with an error after a
part; and the disk remembers which bytes were handed to it for good, and what a name stood for
before. Between two drawn calls the power is lost: then there is a folder of what a computer would
find when it starts again, while this one lives on.
"""

import errno
import io
import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from stat import S_ISDIR
from typing import Any

_real: dict[str, Callable[..., Any]] = {
    name: getattr(os, name)
    for name in ("write", "fsync", "fdatasync", "ftruncate", "replace")
}
_real_open = io.open
HIDDEN = ".before"  # folder of files that have lost their name
SHORT, FULL, BROKEN = "short writes", "no space left", "input/output error"
TROUBLES = (SHORT, FULL, BROKEN)
CALLS = {"write": 60, "sync": 15, "replace": 6}  # of each kind, about so many are seen


class Disk:
    """What holds the files below `folder`, as drawn from `chance`.

    `after` is the folder of what is left when the power is lost; it may never be.
    """

    def __init__(self, folder: Path, after: Path, chance: random.Random) -> None:
        self.folder, self.after, self.chance = folder.resolve(), after, chance
        self.trouble = ""  # what it does now, one of `TROUBLES`
        self.was_in_trouble = False
        self.on_power_loss: Callable[[], None] = lambda: None
        self._last_call = chance.choice(list(CALLS))
        self._calls_left = chance.randint(1, CALLS[self._last_call])
        self._synced: dict[int, int] = {}  # by inode: bytes that are safe
        # by name: what it stood for, hidden, since its folder was synced; None: nothing
        self._before: dict[Path, list[Path | None]] = {}

    def holds(self, path: object) -> bool:
        """Whether a file is on this disk."""
        is_name = isinstance(path, str | os.PathLike)
        return is_name and Path(path).resolve().is_relative_to(self.folder)

    def _begin(self, call: str) -> None:
        if call == self._last_call:
            self._calls_left -= 1
            if self._calls_left == 0:
                self.lose_power()

    def write(self, fd: int, data: Any) -> int:
        """Write some or all of it, as the call of the kernel does."""
        self._begin("write")
        size = len(data)
        if not self.trouble or not size or self.chance.random() < 0.5:
            return _real["write"](fd, data)
        self.was_in_trouble = True
        part = self.chance.randint(0, size - 1)
        if self.trouble == SHORT:
            return _real["write"](fd, data[: max(part, 1)])
        _real["write"](fd, data[:part])
        number = errno.ENOSPC if self.trouble == FULL else errno.EIO
        raise OSError(number, os.strerror(number))

    def sync(self, fd: int) -> None:
        """Note that everything in a file is safe now, or every name in a folder."""
        self._begin("sync")
        if self.trouble == BROKEN and self.chance.random() < 0.5:
            self.was_in_trouble = True
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        stat = os.fstat(fd)
        self._synced[stat.st_ino] = stat.st_size
        if S_ISDIR(stat.st_mode):
            folder = Path(f"/proc/self/fd/{fd}").readlink()
            for path in folder.iterdir():
                self._before.pop(path, None)

    def cut(self, fd: int, size: int) -> None:
        """Note that what a file had beyond `size` is no longer there."""
        inode = os.fstat(fd).st_ino
        self._synced[inode] = min(self._synced.get(inode, 0), size)

    def replace(self, source: Path, target: Path) -> None:
        """Give a file another name; whoever had that before may come back."""
        self._begin("replace")
        old = None
        if target.exists():
            hidden = self.folder / HIDDEN
            hidden.mkdir(exist_ok=True)
            old = hidden / f"{len(list(hidden.iterdir()))}"
            os.link(target, old)
        self._before.setdefault(target, []).append(old)
        _real["replace"](source, target)

    def lose_power(self) -> None:
        """Make the folder of what is found when the power comes back."""
        self.on_power_loss()
        for path in sorted(self.folder.rglob("*")):
            name = path.relative_to(self.folder)
            if path.is_dir() or name.parts[0] == HIDDEN:
                continue
            # What has got its name since the folder was handed to the disk may be missing.
            content = self.chance.choice([path, *self._before.get(path, [])])
            if content is None:
                continue
            stat = content.stat()
            safe = min(self._synced.get(stat.st_ino, 0), stat.st_size)
            size = self.chance.randint(safe, stat.st_size)
            copy = self.after / name
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(content, copy)
            os.truncate(copy, size)


class _File(io.FileIO):
    """The bottom of what `open` returns: it writes to the disk above."""

    disk: Disk

    def write(self, data: Any) -> int:
        return self.disk.write(self.fileno(), memoryview(data).cast("B"))


def put_under(disk: Disk) -> None:
    """Let this process write to files on `disk` by it, from now on."""

    def is_on_disk(fd: int) -> bool:
        return disk.holds(Path(f"/proc/self/fd/{fd}").readlink())

    def write(fd: int, data: Any) -> int:
        return disk.write(fd, data) if is_on_disk(fd) else _real["write"](fd, data)

    def fsync(fd: int) -> None:
        if is_on_disk(fd):
            disk.sync(fd)

    def ftruncate(fd: int, size: int) -> None:
        _real["ftruncate"](fd, size)
        if is_on_disk(fd):
            disk.cut(fd, size)

    def replace(source: Any, target: Any, **named: Any) -> None:
        if disk.holds(target):
            disk.replace(Path(source), Path(target))
        else:
            _real["replace"](source, target, **named)

    def opened(file: Any, mode: str = "r", *args: Any, **named: Any) -> Any:
        if mode != "wb" or not disk.holds(file):
            return _real_open(file, mode, *args, **named)
        raw = _File(file, "wb")
        raw.disk = disk
        return io.BufferedWriter(raw)

    os.write, os.fsync, os.fdatasync = write, fsync, fsync
    os.ftruncate, os.replace, io.open = ftruncate, replace, opened

"""What the daemon does for recorders: a state on request, and virtual time that waits for them.

A recorder of a daemon in virtual time keeps a small locked file beside the image, with the number
of the frame that it reads next. The daemon reads these files between two batches of ticks and
waits for the slowest, unless it has died or has not advanced for `PATIENCE_S`.
"""

import contextlib
import fcntl
import os
import sys
import time
from pathlib import Path

import structlog

from hilserver.core.snapshot import SnapshotStore
from hilserver.errors import UserError
from hilserver.image import ImageReader
from hilserver.image.shared_file import SharedFile, path_of
from hilserver.image.state_request import take_request
from hilserver.tasks import SupervisedTask, Supervisor

PATIENCE_S = 30.0
MARGIN_FRAMES = 128
_LOOK_S = 0.001
_WORD = 8
_log = structlog.get_logger(__name__)


def _prefix(image: str) -> str:
    return f"{image}.reader-"


class Mark:
    """Mark of this process beside the image `image`; at frame 0 until it is moved."""

    def __init__(self, image: str) -> None:
        self._file = SharedFile(f"{_prefix(image)}{os.getpid()}", _WORD)

    def move(self, number: int) -> None:
        """Note that all frames before `number` have been read."""
        self._file.map[:_WORD] = number.to_bytes(_WORD, sys.byteorder)

    def close(self) -> None:
        """Remove the mark."""
        self._file.close()


class Marks:
    """All marks beside an image, for its daemon."""

    def __init__(self, image: ImageReader, name: str, batch_frames: int) -> None:
        self._image = image
        self._path = path_of(name)
        self._prefix = path_of(_prefix(name)).name
        self._room = image.control.ring_length - batch_frames - MARGIN_FRAMES
        self._given_up: dict[Path, int] = {}

    def wait(self) -> None:
        """Wait until the next batch overwrites no frame that a recorder still has to read."""
        for path in self._path.parent.glob(f"{self._prefix}*"):
            with contextlib.suppress(
                OSError
            ):  # it has just ended, or belongs to another user
                fd = os.open(
                    path, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
                )
                try:
                    self._wait_for(path, fd)
                finally:
                    os.close(fd)

    def _wait_for(self, path: Path, fd: int) -> None:
        least = self._image.head - self._room
        last = -1
        deadline_s = 0.0
        while (number := int.from_bytes(os.pread(fd, _WORD, 0), sys.byteorder)) < least:
            if self._given_up.get(path) == number or _is_left_behind(path, fd):
                return
            if number != last:
                last = number
                deadline_s = time.monotonic() + PATIENCE_S
            elif time.monotonic() > deadline_s:
                _log.warning(
                    "a recorder is stalled: going on without it", mark=path.name
                )
                self._given_up[path] = number
                return
            time.sleep(_LOOK_S)


def _is_left_behind(path: Path, fd: int) -> bool:
    """Remove the mark of a recorder that has died; return whether a mark has no recorder."""
    if os.fstat(fd).st_nlink and os.fstat(fd).st_uid == os.geteuid():
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        path.unlink(missing_ok=True)
    return True


class StateService:
    """Looks for requests and lets the plant copy its state; see `image.state_request`."""

    def __init__(self, snapshots: SnapshotStore, image: str, tasks: Supervisor) -> None:
        self._snapshots = snapshots
        self._image = image
        self._tasks = tasks
        self._capturing: SupervisedTask | None = None

    def serve(self) -> None:
        """Begin to serve a request, if there is one; called by the supervise slice."""
        if self._capturing is not None and not self._capturing.done:
            return
        self._capturing = None
        if take_request(self._image):
            self._capturing = self._tasks.spawn(self._capture, "capture state")

    async def _capture(self) -> None:
        try:
            await self._snapshots.capture()
        except (UserError, OSError, TimeoutError) as error:
            _log.warning("no state was saved for the recorder", error=str(error))

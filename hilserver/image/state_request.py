"""How a recorder asks the daemon for a copy of the state, without writing to the image.

The recorder makes an empty file beside the image. The daemon finds it, removes it and has the
plant copy its state into the shadow region between two ticks; the recorder reads it there.
"""

import contextlib
import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hilserver.image.reader import ImageReader
from hilserver.image.shared_file import path_of


def _path(name: str) -> Path:
    return path_of(name).with_suffix(path_of(name).suffix + ".wanted")


def ask_for_state(name: str) -> None:
    """Ask the daemon of the image `name` for a copy of its state."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
    with contextlib.suppress(
        OSError
    ):  # if it fails, the recording lacks a state and reports it
        os.close(os.open(_path(name), flags, 0o600))


def take_request(name: str) -> bool:
    """Return whether a process of the daemon's user asked, and remove the request."""
    path = _path(name)
    try:
        mine = path.lstat().st_uid == os.geteuid()
        path.unlink()
    except OSError:
        return False
    return mine


class ShadowReader:
    """Notices a new state in the shadow region and copies it."""

    def __init__(self, reader: ImageReader) -> None:
        self._reader = reader
        self._seen = reader.control.request_done

    def take(self) -> tuple[int, int, NDArray[np.int64]] | None:
        """Return kind, tick and state of the newest served request, None if there is no new one.

        A restored state serves as well as a saved one, because the plant continued from it. If the
        next request began during the copy, the copy is dropped; the next state comes soon.
        """
        control = self._reader.control
        done = control.request_done
        if done == self._seen:
            return None
        # The plant takes no lock: two equal copies were not made while it wrote.
        copies = [self._reader.shadow.copy(), self._reader.shadow.copy()]
        kind, tick = control.request_kind, control.request_tick
        if control.request != done or not np.array_equal(copies[0], copies[1]):
            return None
        self._seen = done
        return kind, tick, copies[0]


def live_state(reader: ImageReader) -> NDArray[np.int64] | None:
    """Return the state before the first tick; None once a tick has run."""
    state = reader.live.copy()
    return state if reader.head == 0 else None

"""Stop as a word in shared memory: any process of the daemon's user may press it, the step obeys.

The word is the time of the last press. It is in force until the daemon writes the same number as
acknowledged, which it does only on Reset: a press can be neither lost nor mistaken for an older
one, and depends on nothing in the daemon but its paced loop.
"""

import ctypes
import mmap
import os
import time

from hilserver.errors import FailedError
from hilserver.image import layout as lay
from hilserver.image import word
from hilserver.image.shared_file import path_of

_BYTES = lay.N_CONTROL_WORDS * 8


def press_stop(name: str) -> int:
    """Press Stop of the daemon with the image `name`; the ramp begins with its next tick.

    Returns the number now in force: the time of the press [ns], CLOCK_MONOTONIC. FailedError
    if there is no such image, or it has another version.
    """
    try:
        file = os.open(
            path_of(name), os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        )
    except OSError as error:
        reason = (error.strerror or "refused").lower()
        raise FailedError(
            f"cannot stop '{name}': its process image: {reason}"
        ) from None
    try:
        memory = mmap.mmap(file, _BYTES)
    except (OSError, ValueError):
        raise FailedError(
            f"cannot stop '{name}': its process image is not complete"
        ) from None
    finally:
        os.close(file)
    words = (ctypes.c_int64 * lay.N_CONTROL_WORDS).from_buffer(memory)
    if (words[word.MAGIC_WORD], words[word.VERSION]) != (lay.MAGIC, lay.VERSION):
        raise FailedError(
            f"cannot stop '{name}': another hilserver version made its image"
        )
    pressed_ns = time.monotonic_ns()
    words[word.STOP_REQUEST] = pressed_ns  # one store of eight bytes
    return pressed_ns

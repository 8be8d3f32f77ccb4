"""``hilserver run``, and one thread more: a number on standard input holds the interpreter lock.

So many seconds no Python runs in this process, as while some library computes without giving way.
Everything else is the program that users start.
"""

import ctypes
import os
import sys
import threading

from hilserver.commands import main


def _hold_when_asked() -> None:
    library = ctypes.PyDLL(None)  # calls that keep the lock
    while text := os.read(0, 64):
        library.usleep(round(float(text) * 1e6))


if __name__ == "__main__":
    threading.Thread(target=_hold_when_asked, daemon=True).start()
    sys.exit(main(sys.argv[1:]))

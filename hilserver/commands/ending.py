"""SIGINT and SIGTERM end a command at any time, from its first import on."""

import contextlib
import signal
import sys
import threading
from collections.abc import Iterator

from hilserver.errors import EXIT_DONE

_ENDING = (signal.SIGINT, signal.SIGTERM)
_caught: list[int] = []


@contextlib.contextmanager
def ended_by_signals() -> Iterator[None]:
    """Let the signals raise SystemExit within the block.

    A KeyboardInterrupt would not do: even one that is caught makes the interpreter end itself by
    SIGINT when it passed through a module that runs Python code from C. ``run`` replaces the
    handlers as soon as the daemon can be stopped in order.
    """
    _caught.clear()
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    hook = sys.unraisablehook
    before = {number: signal.signal(number, _end) for number in _ENDING}
    try:
        yield
    finally:
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)


def _end(number: int, _frame: object) -> None:
    _caught.append(number)
    sys.unraisablehook = lambda _: None  # an interrupted callback of the compiler is no news
    raise SystemExit(EXIT_DONE)


def end_was_asked() -> bool:
    """Return True when a signal has come, even one whose exception the compiler swallowed."""
    return bool(_caught)

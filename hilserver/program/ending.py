"""SIGINT and SIGTERM end a program at any time, from its first import on."""

import contextlib
import signal
import sys
import threading
from collections.abc import Callable, Iterator

from hilserver.errors import EXIT_DONE

ENDING = (signal.SIGINT, signal.SIGTERM)
_caught: list[int] = []
_said: list[str] = []
_hang_ups: list[int] = []


@contextlib.contextmanager
def ended_by_signals() -> Iterator[None]:
    """Let the signals raise SystemExit within the block.

    KeyboardInterrupt would not do: even if caught, it makes the interpreter end itself by SIGINT
    when it has passed through a module that runs Python code from C. A program that can stop in an
    orderly way replaces the handlers: `on_end`, or `event_loop.end_event`.
    """
    _caught.clear()
    _said.clear()
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    hook = sys.unraisablehook
    before = {number: signal.signal(number, _end) for number in ENDING}
    try:
        yield
    finally:
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)


def _end(number: int, _frame: object) -> None:
    _caught.append(number)
    sys.unraisablehook = lambda _: None  # an interrupted compiler callback is expected
    raise SystemExit(EXIT_DONE)


def end_was_asked() -> bool:
    """Return True when a signal has come, even one whose exception the compiler swallowed."""
    return bool(_caught)


def say_stopped(sentence: str) -> None:
    """Say what is left, if a signal has come and nobody has said it: its exit code is 0."""
    if end_was_asked() and not _said:
        _said.append(sentence)
        print(f"hilserver: {sentence}", file=sys.stderr, flush=True)


def on_end(stop: Callable[[], object]) -> None:
    """Let the signals call `stop` from now on, at once if one has come already."""
    for number in ENDING:
        signal.signal(number, lambda *_: stop())
    if end_was_asked():
        stop()


@contextlib.contextmanager
def hang_ups_wait() -> Iterator[None]:
    """Keep a SIGHUP for `event_loop.hang_ups` within the block; otherwise it would end us."""
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGHUP) is not signal.SIG_DFL:
        yield
        return
    _hang_ups.clear()
    signal.signal(signal.SIGHUP, lambda number, _: _hang_ups.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)


def hang_up_waits() -> bool:
    """Return True, once, if a SIGHUP has come and is kept."""
    waits = bool(_hang_ups)
    _hang_ups.clear()
    return waits

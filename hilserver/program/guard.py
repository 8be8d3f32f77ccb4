"""A thread that ends the process at SIGINT or SIGTERM, whatever its other threads do.

Python runs a signal handler between two instructions of the main thread, and an event loop handles
signals between two callbacks: a compiler, or a callback that never returns, delays both. Here every
other thread blocks the signals, and the guard waits for them. Until an orderly stop is possible,
the first signal ends the process at once. From then on the program has `ANSWER_S` to acknowledge it
and `STOP_S` to end; a second signal ends it at once.
"""

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import NoReturn

from hilserver.errors import EXIT_DONE, EXIT_FAILED
from hilserver.program.ending import ENDING

ANSWER_S, STOP_S = 1.5, 2.1  # counted from the signal
CHILD_S = 0.2  # time for a child to end before it is killed
_LOOK_S = 0.05
_cleanups: list[Callable[[], object]] = []
_limits_s = [STOP_S]


def on_forced_end(cleanup: Callable[[], object]) -> Callable[[], None]:
    """Have `cleanup` called if the process is ended by force; return a function to revoke that."""
    _cleanups.append(cleanup)

    def revoke() -> None:
        with contextlib.suppress(ValueError):
            _cleanups.remove(cleanup)

    return revoke


def allow(seconds: float) -> None:
    """Allow this much time from the signal to the end: a slow disk may need it."""
    _limits_s.append(seconds)


class Guard:
    """Waits for signals in a thread of its own."""

    def __init__(self, signals: Collection[int]) -> None:
        self._signals = signals
        self.say: Callable[[str], object] = lambda _: None  # must not block
        # whether a signal has come; exit code of a forced end, unless the program is blocked
        self.is_asked = False
        self.code = EXIT_DONE
        self._stop: Callable[[], object] | None = None
        self._if_blocked: Callable[[], object] = lambda: None
        self._is_over = self._is_answered = self._is_leaving = False
        self._thread = threading.Thread(target=self._run, name="guard", daemon=True)
        self._thread.start()

    def on_end(
        self, stop: Callable[[], object], if_blocked: Callable[[], object]
    ) -> None:
        """Let the first signal call `stop` instead of ending at once; both run in this thread.

        `if_blocked` is called before the end if `answer` was not.
        """
        self._stop = stop
        self._if_blocked = if_blocked

    def answer(self) -> None:
        """Acknowledge the signal: the program is about to end."""
        self._is_answered = True

    def forward(self, number: int, *_: object) -> None:
        """Take a signal that reached another thread after all."""
        signal.pthread_kill(self._thread.ident or 0, number)

    def close(self) -> None:
        """End the thread, unless a signal has come: then it watches the process to its end."""
        if self._is_leaving:  # errors now only come from its children being ended
            self._thread.join()
        if not self.is_asked:
            self._is_over = True
            self.forward(ENDING[0])
            self._thread.join()

    def _run(self) -> None:
        signal.sigwait(self._signals)
        if self._is_over:
            return
        self.is_asked = True
        if self._stop is None:
            self._leave(EXIT_DONE, "has stopped while it was starting")
        asked_s = time.monotonic()
        self._stop()
        while (passed_s := time.monotonic() - asked_s) < max(_limits_s):
            if not self._is_answered and passed_s > ANSWER_S:
                self._if_blocked()
                self._leave(EXIT_FAILED, "is forced to exit: its event loop is blocked")
            if signal.sigtimedwait(self._signals, _LOOK_S) is not None:
                self._leave(self.code, "exits at once: a second signal arrived")
        self._leave(self.code, "is forced to exit: a part did not stop in time")

    def _leave(self, code: int, why: str) -> NoReturn:
        self._is_leaving = True
        # End our children, first with SIGTERM; ignore those that have ended
        deadline_s = time.monotonic() + CHILD_S
        for number in (signal.SIGTERM, signal.SIGKILL):
            for child in _children():
                with contextlib.suppress(OSError):
                    os.kill(child, number)
            while (
                number == signal.SIGTERM and _alive() and time.monotonic() < deadline_s
            ):
                time.sleep(_LOOK_S / 5)
        for cleanup in reversed(_cleanups):
            with contextlib.suppress(Exception):
                cleanup()
        # last, after the output of the other threads
        self.say(f"{why}, exit code {code}")
        os._exit(code)


@contextlib.contextmanager
def guarded(signals: Collection[int] = ENDING) -> Iterator[Guard]:
    """Guard the process within the block; enter it before other threads are started."""
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    guard = Guard(signals)
    before = {number: signal.signal(number, guard.forward) for number in signals}
    try:
        yield guard
    finally:
        guard.close()
        if not guard.is_asked:
            for number, handler in before.items():
                signal.signal(number, handler)
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _children() -> list[int]:
    tasks = Path("/proc/self/task").glob("*/children")
    return [
        int(word) for task in tasks for word in task.read_text(encoding="ascii").split()
    ]


def _alive() -> bool:
    for child in _children():
        with contextlib.suppress(OSError):
            stat = Path(f"/proc/{child}/stat").read_text(
                encoding="utf-8", errors="replace"
            )
            if ") Z " not in stat:
                return True
    return False

"""Compiles in a child and reports progress: a start that compiles takes a minute or two.

A compiler cannot be interrupted; a process can be killed. The child goes through the same start, so
that everything is then in the cache on disk.
"""

import contextlib
import os
import select
import signal
import subprocess
from collections.abc import Callable, Iterator, Sequence

from numba.core import event
from numba.core.caching import FunctionCache

from hilserver.program import children
from hilserver.program.ending import ENDING
from hilserver.program.workers import end_with_parent

TELL_EVERY_S = 1.0


class _Compiling(event.Listener):  # type: ignore[misc]
    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell

    def on_start(self, event: event.Event) -> None:
        self._tell(event.data["dispatcher"].py_func.__name__)

    def on_end(self, event: event.Event) -> None:
        pass


@contextlib.contextmanager
def telling(tell: Callable[[str], None]) -> Iterator[None]:
    """Call `tell` with the name of every function compiled in the block, in the compiling thread.

    Functions from the cache are not compiled.
    """
    with event.install_listener("numba:compile", _Compiling(tell)):
        yield


@contextlib.contextmanager
def in_child(command: Sequence[str], tell: Callable[[Sequence[str]], None]) -> Iterator[None]:
    """Run `command` before anything is compiled in the block; what it caches is not compiled here.

    Parameters
    ----------
    command : sequence of str
        Its child's `main` is `as_child`. It runs once, and only if something is not in the cache.
    tell : callable
        Called every second, and at each report, with the functions whose compilation begins.
    """
    load, waiting = FunctionCache.load_overload, [command]

    def load_or_fill(self: FunctionCache, *what: object) -> object:
        found = load(self, *what)
        if found is None and waiting:
            _run(waiting.pop(), tell)
            found = load(self, *what)
        return found

    FunctionCache.load_overload = load_or_fill
    try:
        yield
    finally:
        FunctionCache.load_overload = load


def _run(command: Sequence[str], tell: Callable[[Sequence[str]], None]) -> None:
    """Run a child to its end; if it fails, we do its work and meet its errors ourselves."""
    quiet = {"stdin": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
    with children.piped([*command, str(os.getpid())], name="compiler", **quiet) as child:
        assert child.stdout is not None
        data = b" "
        while data:
            tell(data.decode(errors="replace").split())
            is_news = select.select([child.stdout], [], [], TELL_EVERY_S)[0]
            data = os.read(child.stdout.fileno(), 1 << 12) if is_news else b" "


def as_child(main: Callable[[], object], parent: int) -> None:
    """Run `main` and report to `parent` what it compiles; end when the parent ends or asks."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)  # the parent's guard blocks them for us, too
    end_with_parent(parent)
    with telling(lambda name: print(name, flush=True)):
        main()

"""Compiles in children and reports progress: a start that compiles takes a minute or two.

A compiler cannot be interrupted; a process can be killed. The children go through the same start
and share the work (`hilserver.compiled.sharing`), so that everything is then in the cache on disk.
"""

import contextlib
import functools
import gc
import os
import selectors
import signal
import subprocess
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from numba.core import event

from hilserver.compiled.cache import stored
from hilserver.program import children
from hilserver.program.ending import ENDING
from hilserver.program.workers import end_with_parent

TELL_EVERY_S = 1.0
KB_PER_PROCESS = 700_000
"""A process that compiles the step took 580 MB."""


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
def in_children(
    commands: Callable[[], Sequence[Sequence[str]]],
    tell: Callable[[Sequence[str]], None],
) -> Iterator[None]:
    """Run `commands` before anything is compiled in the block; what they keep is not compiled here.

    Parameters
    ----------
    commands : callable
        Called once, when something is not in the cache, for the command lines to run. The `main` of
        each is `as_child`; the first one compiles all, the others help.
    tell : callable
        Called every second, and at each report, with the functions whose compilation begins.
    """
    share = functools.partial(_run, commands, tell)
    if stored is not None:
        stored.on_miss.append(share)
    try:
        yield
    finally:
        if stored is not None and share in stored.on_miss:
            stored.on_miss.remove(share)


def _run(
    commands: Callable[[], Sequence[Sequence[str]]],
    tell: Callable[[Sequence[str]], None],
) -> None:
    """Run children until the first has ended; if it fails, we do its work and meet its errors."""
    quiet = {
        "stdin": subprocess.DEVNULL,
        "stderr": subprocess.DEVNULL,
        "start_new_session": True,
    }
    with contextlib.ExitStack() as begun, selectors.DefaultSelector() as reports:
        for number, command in enumerate(commands()):
            child = begun.enter_context(
                children.piped([*command, str(os.getpid())], name="compiler", **quiet)
            )
            assert child.stdout is not None
            reports.register(child.stdout, selectors.EVENT_READ, number == 0)
        is_first_done = False
        while not is_first_done:
            tell([])
            for key, _ in reports.select(TELL_EVERY_S):
                data = os.read(key.fd, 1 << 12)
                tell(data.decode(errors="replace").split())
                if not data:
                    reports.unregister(key.fileobj)
                    is_first_done |= key.data


def processes() -> int:
    """Return how many processes this computer has the cores and the memory for."""
    cores = len(os.sched_getaffinity(0))
    with contextlib.suppress(OSError, ValueError, AttributeError):
        text = Path("/proc/meminfo").read_text(encoding="ascii")
        available_kb = int(text.partition("MemAvailable:")[2].split()[0])
        return max(1, min(cores, available_kb // KB_PER_PROCESS))
    return 1


def as_child(main: Callable[[], object], parent: int) -> None:
    """Run `main` and report to `parent` what it compiles; end when the parent ends or asks.

    The garbage collector is off: what a compiler makes stays, and scanning it took a tenth.
    """
    gc.disable()
    # the parent's guard blocks them for us, too
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
    end_with_parent(parent)
    with telling(lambda name: print(name, flush=True)):
        main()

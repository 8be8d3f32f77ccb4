"""Worker processes for many independent tasks; they end when their parent does."""

import contextlib
import ctypes
import multiprocessing
import os
import signal
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import TypeVar

from hilserver.errors import FailedError

T = TypeVar("T")
R = TypeVar("R")
PR_SET_PDEATHSIG = 1


def end_with_parent(parent: int) -> None:
    """Ask the kernel to end this worker when the process that started it ends in any way.

    Otherwise the workers of a killed campaign would continue with queued tasks. Linux only;
    elsewhere nothing happens.
    """
    prctl = getattr(ctypes.CDLL(None), "prctl", None)
    if prctl is None:
        return
    prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if os.getppid() != parent:  # it ended before we asked
        os.kill(os.getpid(), signal.SIGTERM)


def lower(nice: int) -> None:
    """Lower the priority of this process, and of its session if it leads one.

    With autogroups a session competes as a whole, with its own value (sched(7)): in a session with
    a single process, `nice` alone has no effect.
    """
    os.nice(nice)
    if os.getsid(0) == os.getpid():
        with contextlib.suppress(OSError):
            Path("/proc/self/autogroup").write_text(str(nice), encoding="ascii")


def in_processes(
    function: Callable[[T], R], tasks: Sequence[T], workers: int
) -> Generator[tuple[int, R], None, None]:
    """Yield the index and result of every task, as they come.

    To stop early, close the generator (`contextlib.closing`): the workers then end at once;
    otherwise the interpreter would wait at its exit for all queued tasks. FailedError if a worker
    process is ended from outside.
    """
    if workers <= 1 or len(tasks) <= 1:
        yield from ((index, function(task)) for index, task in enumerate(tasks))
        return
    context = multiprocessing.get_context("spawn")
    count = min(workers, len(tasks))
    others = set(multiprocessing.active_children())
    with ProcessPoolExecutor(count, context, end_with_parent, (os.getpid(),)) as pool:
        waiting = {
            pool.submit(function, task): index for index, task in enumerate(tasks)
        }
        try:
            for future in as_completed(waiting):
                yield waiting[future], future.result()
        except BrokenProcessPool:
            raise FailedError(
                "a worker process was killed, perhaps because memory ran out; try fewer --jobs"
            ) from None
        except BaseException:
            for worker in set(multiprocessing.active_children()) - others:
                worker.terminate()
            raise
        finally:
            pool.shutdown(cancel_futures=True)  # waits: else its thread runs on at exit

"""Hundreds of logs: each a diagnosis of its own, in worker processes or on a Dask cluster."""

import ctypes
import multiprocessing
import os
import signal
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from hilserver.errors import FailedError

T = TypeVar("T")
R = TypeVar("R")
CONNECT_WITHIN_S = 10
PR_SET_PDEATHSIG = 1


def end_with_parent(parent: int) -> None:
    """Ask the kernel to end this worker when the process that started it ends, however it does.

    Otherwise the workers of a campaign that was killed go on with what is queued. Linux; elsewhere
    nothing happens.
    """
    prctl = getattr(ctypes.CDLL(None), "prctl", None)
    if prctl is None:
        return
    prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if os.getppid() != parent:  # it ended before we asked
        os.kill(os.getpid(), signal.SIGTERM)


def in_processes(
    function: Callable[[T], R], tasks: Sequence[T], workers: int
) -> Generator[tuple[int, R], None, None]:
    """Yield the index and result of every task, as they come.

    Who stops before the end closes the generator (`contextlib.closing`), and the workers end at
    once; otherwise the interpreter would wait at its end for all that is queued.

    Parameters
    ----------
    function : callable
        A function of a module, as it travels by its name.
    workers : int
        Processes; 1: this one.

    Raises
    ------
    FailedError
        If a worker process is ended from outside.
    """
    if workers <= 1 or len(tasks) <= 1:
        yield from ((index, function(task)) for index, task in enumerate(tasks))
        return
    context = multiprocessing.get_context("spawn")
    count, others = min(workers, len(tasks)), set(multiprocessing.active_children())
    with ProcessPoolExecutor(count, context, end_with_parent, (os.getpid(),)) as pool:
        waiting = {pool.submit(function, task): index for index, task in enumerate(tasks)}
        try:
            for future in as_completed(waiting):
                yield waiting[future], future.result()
        except BrokenProcessPool:
            raise FailedError(
                "a worker process was ended, perhaps for want of memory; try fewer --jobs"
            ) from None
        except BaseException:
            for worker in set(multiprocessing.active_children()) - others:
                worker.terminate()
            raise
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def on_cluster(
    function: Callable[[T], R], tasks: Sequence[T], address: str
) -> Generator[tuple[int, R], None, None]:
    """Yield the index and result of every task from a Dask cluster.

    Its workers must have this version of hilserver and see the logs under the same paths.

    Raises
    ------
    FailedError
        If the extra is not installed or nobody answers at the address.
    """
    with _client(address) as client:
        futures = client.map(function, tasks, pure=False)
        waiting = {future.key: index for index, future in enumerate(futures)}
        from distributed import as_completed as completed  # noqa: PLC0415 (an extra)

        for future in completed(futures):
            yield waiting[future.key], future.result()


def _client(address: str) -> Any:
    try:
        from distributed import Client  # noqa: PLC0415 (an extra)
    except ImportError:
        raise FailedError(
            "--dask needs the extra 'dask': python -m pip install 'hilserver[dask]'"
        ) from None
    try:
        return Client(address, timeout=CONNECT_WITHIN_S)
    except (OSError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise FailedError(f"--dask {address}: no cluster answers there: {reason}") from None

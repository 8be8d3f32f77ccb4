"""Hands batches of machines to workers, with a limited number under way, and survives workers.

Workers are processes of this computer or of a Dask cluster, behind the same interface of
`concurrent.futures`; nothing here decides where a batch runs. A batch whose worker died is driven
again, machine by machine, which finds a machine that kills its worker.
"""

import multiprocessing
import os
from collections.abc import Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from itertools import islice
from typing import Any, Final, Protocol

from hilserver.diagnosis.many import connected
from hilserver.errors import FailedError
from hilserver.sweep.batch import begin_worker, fingerprint, run_batch
from hilserver.sweep.prepare import SentMachine, SweepJob
from hilserver.sweep.rig import MachineOutcome

IN_A_BATCH: Final = 8
BATCHES_AHEAD: Final = 3  # batches under way for each worker
LIVES: Final = 3  # a machine fails when this many workers have died with it alone
STARTS: Final = 30
Result = tuple[str, list[MachineOutcome]]


class Workers(Protocol):
    """Where batches run."""

    count: int

    def submit(self, job: SweepJob, machines: list[SentMachine]) -> "Future[Result]":
        """Have machines driven."""

    def means_death(self, error: BaseException) -> bool:
        """Return whether an error means that a worker is gone."""

    def renew(self) -> None:
        """Replace workers that are gone."""


class LocalWorkers(AbstractContextManager["LocalWorkers"]):
    """Processes of this computer, with limits for memory."""

    def __init__(self, count: int, memory_mb: float) -> None:
        self.count = count
        self._memory_mb = memory_mb
        self._others = set(multiprocessing.active_children())
        self._pool = self._new()

    def _new(self) -> Executor:
        context = multiprocessing.get_context("spawn")
        arguments = (os.getpid(), self._memory_mb)
        return ProcessPoolExecutor(self.count, context, begin_worker, arguments)

    def submit(self, job: SweepJob, machines: list[SentMachine]) -> "Future[Result]":
        """Have machines driven."""
        try:
            return self._pool.submit(run_batch, job, machines)
        except BrokenProcessPool as error:
            lost: Future[Result] = Future()
            lost.set_exception(error)
            return lost

    def means_death(self, error: BaseException) -> bool:
        """Return whether a process is gone, and the pool with it."""
        return isinstance(error, BrokenProcessPool)

    def renew(self) -> None:
        """Start all processes anew."""
        self._pool.shutdown(wait=False, cancel_futures=True)
        self._pool = self._new()

    def __exit__(self, *_: object) -> None:
        # Before Python 3.14 a pool has no method that ends a worker in the middle of a batch.
        for worker in set(multiprocessing.active_children()) - self._others:
            worker.terminate()
        self._pool.shutdown(wait=True, cancel_futures=True)


class DaskWorkers(AbstractContextManager["DaskWorkers"]):
    """Workers of a Dask cluster; they see the files of the sweep under the same paths."""

    def __init__(self, address: str) -> None:
        self._client = connected(address)
        self.count = max(sum(self._client.nthreads().values()), 1)
        self._executor: Any = self._client.get_executor(pure=False)

    def submit(self, job: SweepJob, machines: list[SentMachine]) -> "Future[Result]":
        """Have machines driven."""
        future: Future[Result] = self._executor.submit(run_batch, job, machines)
        return future

    def means_death(self, error: BaseException) -> bool:
        """Return whether Dask gave up a batch because its workers died."""
        return type(error).__name__ in ("KilledWorker", "CancelledError")

    def renew(self) -> None:
        """Do nothing: Dask does it."""

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown(wait=False)
        self._client.close()


def outcomes(
    job: SweepJob,
    machines: Iterable[SentMachine],
    workers: Workers,
    *,
    mixed: bool = False,
) -> Iterator[Result]:
    """Yield where batches ran and the outcomes of their machines, as they finish.

    FailedError if a computer gives other bits than this one, unless `mixed`.
    """
    source: Iterator[SentMachine] = iter(machines)
    pending: dict[Future[Result], list[SentMachine]] = {}
    while True:
        while len(pending) < BATCHES_AHEAD * workers.count and (
            batch := list(islice(source, IN_A_BATCH))
        ):
            pending[workers.submit(job, batch)] = batch
        if not pending:
            return
        # The machines of workers that died are lost, and driven again.
        done, _ = wait(pending, return_when=FIRST_COMPLETED)
        errors = [error for future in done if (error := future.exception()) is not None]
        if any(map(workers.means_death, errors)):
            # in a pool of processes all fail together, and it is renewed
            done, _ = wait(pending)
            workers.renew()
        results = []
        lost = list[SentMachine]()
        for future in done:
            sent = pending.pop(future)
            error = future.exception()
            if error is None:
                results.append(future.result())
            elif workers.means_death(error):
                lost += sent
            else:
                raise error
        for result in results:
            yield _checked(result, mixed)
        for machine in lost:
            yield _checked(_alone(job, machine, workers), mixed)


def _alone(job: SweepJob, machine: SentMachine, workers: Workers) -> Result:
    """Drive a machine that may have ended a worker, alone."""
    for _ in range(LIVES):
        _awake(job, workers)
        if (result := _tried(job, [machine], workers)) is not None:
            return result
    text = (
        f"stopped its worker {LIVES} times: its code does not return within"
        f" {job.sweep.limits.time_s:g} s, needs too much memory, or crashes"
    )
    return fingerprint(), [MachineOutcome(machine.index, error=text)]


def _awake(job: SweepJob, workers: Workers) -> None:
    """Wait for a worker that is ready: no machine is to blame for one killed during its start.

    FailedError if no worker becomes ready.
    """
    for _ in range(STARTS):
        if _tried(job, [], workers) is not None:
            return
    raise FailedError(f"{STARTS} workers died while starting; is there enough memory?")


def _tried(
    job: SweepJob, machines: list[SentMachine], workers: Workers
) -> Result | None:
    """Return the result of a batch; None if its worker died, in whose place there is a new one."""
    try:
        return workers.submit(job, machines).result()
    except BaseException as error:
        if not workers.means_death(error):
            raise
    workers.renew()
    return None


def _checked(result: Result, mixed: bool) -> Result:
    where = result[0]
    if where != fingerprint() and not mixed:
        raise FailedError(
            f"the results of a worker are not bit-identical ({where}, here {fingerprint()}): its"
            " hilserver version, processor or math library differs; use identical workers, or"
            " --mixed"
        )
    return result

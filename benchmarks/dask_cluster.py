"""A Dask cluster on this computer: a scheduler and workers, each a process."""

import contextlib
import os
import subprocess
import tempfile
from collections.abc import Iterator
from typing import Any, Final

from hilserver.errors import FailedError
from hilserver.program.children import free_port, piped, python

START_WITHIN_S: Final = 120.0


@contextlib.contextmanager
def cluster(workers: int) -> Iterator[str]:
    """Run a cluster while the context lasts; give its address.

    A worker that is killed is started again by its nanny, as on a real cluster.
    """
    address = f"tcp://127.0.0.1:{free_port()}"
    none = subprocess.DEVNULL
    quiet: dict[str, Any] = {"stdout": none, "stderr": none, "stdin": None}
    with tempfile.TemporaryDirectory(prefix="hilserver-dask-") as folder:
        scheduler = python("-m", "distributed.cli.dask_scheduler", "--no-dashboard")
        scheduler += ["--host", address]
        worker = python("-m", "distributed.cli.dask_worker", address, "--no-dashboard")
        worker += [
            "--nworkers",
            str(workers),
            "--nthreads",
            "1",
            "--local-directory",
            folder,
        ]
        with (
            piped(scheduler, name="dask scheduler", **quiet),
            piped(worker, name="dask worker", **quiet),
        ):
            _wait(address, workers)
            yield address


def _wait(address: str, workers: int) -> None:
    from distributed import Client  # noqa: PLC0415 - an extra

    try:
        with Client(address, timeout=START_WITHIN_S) as client:
            client.wait_for_workers(workers, timeout=START_WITHIN_S)
    except (OSError, TimeoutError) as error:
        raise FailedError(f"no Dask cluster came up: {error!s:.200}") from None


def worker_pids(address: str) -> list[int]:
    """Return the current processes of a cluster's workers."""
    from distributed import Client  # noqa: PLC0415 - an extra

    with Client(address, timeout=START_WITHIN_S) as client:
        return list(client.run(os.getpid).values())

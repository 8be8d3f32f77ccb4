"""Hundreds of logs on a Dask cluster: each a diagnosis of its own."""

from collections.abc import Callable, Generator, Sequence
from typing import Any, TypeVar

from hilserver.errors import FailedError

T = TypeVar("T")
R = TypeVar("R")
CONNECT_WITHIN_S = 10


def on_cluster(
    function: Callable[[T], R], tasks: Sequence[T], address: str
) -> Generator[tuple[int, R], None, None]:
    """Yield the index and result of every task from a Dask cluster.

    The workers must have this version of hilserver and see the logs under the same paths.

    Raises
    ------
    FailedError
        If the extra is not installed or there is no answer from the address.
    """
    with connected(address) as client:
        futures = client.map(function, tasks, pure=False)
        waiting = {future.key: index for index, future in enumerate(futures)}
        from distributed import as_completed as completed  # noqa: PLC0415 (an extra)

        for future in completed(futures):
            yield waiting[future.key], future.result()


def connected(address: str) -> Any:
    """Return a client of the cluster at an address.

    Raises
    ------
    FailedError
        If the extra is not installed or there is no answer.
    """
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
        raise FailedError(
            f"--dask {address}: no cluster answers at this address: {reason}"
        ) from None

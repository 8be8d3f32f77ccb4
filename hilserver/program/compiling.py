"""Says what is being compiled, while it is: a start that compiles takes a minute or two."""

import contextlib
from collections.abc import Callable, Iterator

from numba.core import event


class _Compiling(event.Listener):  # type: ignore[misc]
    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell

    def on_start(self, event: event.Event) -> None:
        self._tell(event.data["dispatcher"].py_func.__name__)

    def on_end(self, event: event.Event) -> None:
        pass


@contextlib.contextmanager
def telling(tell: Callable[[str], None]) -> Iterator[None]:
    """Call `tell` with the name of every function that is compiled in the block, in its thread.

    What comes from the cache is not compiled.
    """
    with event.install_listener("numba:compile", _Compiling(tell)):
        yield

"""Several processes compile the functions of one program side by side, for one cache.

Each goes through the same start and puts off, in the same order, what it would compile. Whoever
comes first to a function compiles it; the others wait only where they need it themselves. No
process knows the others: one that ends leaves its work to the rest.
"""

import contextlib
from collections.abc import Callable, Iterator

from hilserver.cache import Shelf


class Backlog:
    """What one process has put off."""

    def __init__(self, shelf: Callable[[], Shelf], *, is_helper: bool) -> None:
        self._shelf = shelf
        self._is_helper = is_helper  # the one that is not waits for all and goes on
        self._waiting: dict[Callable[[], None], str] = {}

    def put_off(self, name: str, compile_now: Callable[[], None]) -> None:
        """Compile a function later; `name` is the same in all processes."""
        self._waiting[compile_now] = name

    def take(self, compile_now: Callable[[], None]) -> None:
        """Compile a function now, unless that is done."""
        if self._waiting.pop(compile_now, None) is not None:
            compile_now()

    def work(self) -> None:
        """Compile what no other process has begun; a helper ends with that.

        The last ones come first: they call the others, and take the longest.
        """
        for compile_now, name in reversed(list(self._waiting.items())):
            if self._shelf().claimed(f"share of {name}"):
                # What cannot be compiled alone is compiled, or reported, by who uses it.
                with contextlib.suppress(Exception):
                    self.take(compile_now)
        if self._is_helper:
            raise SystemExit
        _current.clear()
        for compile_now in list(self._waiting):
            self.take(compile_now)


_current: list[Backlog] = []


def current() -> Backlog | None:
    """Return what this process has put off; None: it compiles at once."""
    return _current[0] if _current else None


@contextlib.contextmanager
def shared(shelf: Callable[[], Shelf], *, is_helper: bool) -> Iterator[None]:
    """Put off what would be compiled in the block, until `Backlog.work`."""
    _current.append(Backlog(shelf, is_helper=is_helper))
    try:
        yield
    finally:
        _current.clear()

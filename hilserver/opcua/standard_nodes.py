"""The 6,000 standard nodes of every OPC UA server, kept on disk beside the compiled kernels.

asyncua builds them node by node, which takes most of a server's start.
"""

import asyncio
import contextlib
import gc
import os
import pickle
import tempfile
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from asyncua import ua
from asyncua.server.address_space import AttributeValue
from asyncua.server.internal_server import InternalServer

from hilserver.cache import cache_folder

NODES_PER_PICKLE: Final = 50
"""Nodes per pickle: reading one keeps all its intermediates, about 100 MB for all nodes."""


class QuickInternalServer(InternalServer):  # type: ignore[misc]
    """asyncua's inner server; its standard nodes are built once and then read from a file."""

    async def load_standard_address_space(self, shelf_file: Path | None = None) -> None:
        """Fill the address space; `shelf_file` is where asyncua itself would keep the nodes."""
        path = nodes_file()
        with _no_collection():
            if not await asyncio.to_thread(self._read, path):
                await super().load_standard_address_space(shelf_file)
                _share(self.aspace._nodes)
                await asyncio.to_thread(self._write, path)

    def _read(self, path: Path) -> bool:
        nodes = self.aspace._nodes
        try:
            with path.open("rb") as file:
                while file.peek(1):
                    nodes.update(pickle.load(file))  # noqa: S301 - our own file in our own folder
        except Exception:  # noqa: BLE001 - a damaged file may raise anything; it is written anew
            nodes.clear()
        return bool(nodes)

    def _write(self, path: Path) -> None:
        nodes = list(self.aspace._nodes.items())
        # Complete or absent: other processes may start at the same moment.
        with contextlib.suppress(OSError):
            handle, unfinished = tempfile.mkstemp(dir=path.parent)
            try:
                with os.fdopen(handle, "wb") as file:
                    for first in range(0, len(nodes), NODES_PER_PICKLE):
                        _Pickler(file, -1).dump(nodes[first : first + NODES_PER_PICKLE])
                Path(unfinished).replace(path)
            except OSError:
                Path(unfinished).unlink(missing_ok=True)


def nodes_file() -> Path:
    """Return the file of the nodes of this version of asyncua."""
    return cache_folder("opcua") / f"shared_nodes-{version('asyncua')}.pickles"


class _Pickler(pickle.Pickler):
    """Writes an attribute as a call: reading it takes half the memory of object and state."""

    def reducer_override(self, part: Any) -> Any:
        return (
            (AttributeValue, (part.value,))
            if type(part) is AttributeValue
            else NotImplemented
        )


def _share(nodes: Any) -> None:
    """Make equal attributes one object, except values of variables, which may change."""
    pool: dict[bytes, Any] = {}
    for node in nodes.values():
        for attribute, place in node.attributes.items():
            if attribute != ua.AttributeIds.Value:
                place.value = pool.setdefault(pickle.dumps(place.value), place.value)


@contextlib.contextmanager
def _no_collection() -> Iterator[None]:
    """No garbage collection: it would double the time for tens of thousands of live objects."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()

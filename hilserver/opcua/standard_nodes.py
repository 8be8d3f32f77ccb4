"""The 6,000 standard nodes of every OPC UA server, kept in the cache and read when they are needed.

asyncua builds them node by node, which takes most of a server's start. A server needs an eighth of
them to start; a client that browses the types has the others read, one portion at a time.
"""

import asyncio
import contextlib
import gc
import io
import pickle
import zlib
from collections.abc import Iterator, MutableMapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, NamedTuple

from asyncua import ua
from asyncua.server.address_space import AttributeValue
from asyncua.server.internal_server import InternalServer

from hilserver.cache import Shelf

NODES_PER_PORTION: Final = 50
"""Reading a portion takes a millisecond or two of the event loop."""

SHELF: Final = "opcua"
"""Folder of the cache."""


class Portion(NamedTuple):
    """Some of the standard nodes, as they are kept."""

    node_ids: tuple[tuple[int, Any], ...]  # namespace index and identifier of each
    nodes: bytes  # a dict, pickled and compressed


class Nodes(MutableMapping[ua.NodeId, Any]):
    """The nodes of an address space; standard ones are read when somebody asks for them.

    Parameters
    ----------
    portions : sequence of Portion
        What is not read yet.
    """

    def __init__(self, portions: Sequence[Portion]) -> None:
        self._read: dict[ua.NodeId, Any] = {}
        self._unread = dict(enumerate(portions))
        self._portion_of = {
            node_id: number
            for number, portion in self._unread.items()
            for node_id in portion.node_ids
        }

    @property
    def n_unread(self) -> int:
        """Number of portions that nobody has asked for."""
        return len(self._unread)

    def __getitem__(self, node_id: ua.NodeId) -> Any:
        try:
            return self._read[node_id]
        except KeyError:
            # a literal of a client's filter may be anything
            if not isinstance(node_id, ua.NodeId):
                raise
            number = self._portion_of.get((node_id.NamespaceIndex, node_id.Identifier))
            if number not in self._unread:
                raise
        self._take(number)
        return self._read[node_id]

    def __setitem__(self, node_id: ua.NodeId, node: Any) -> None:
        self.get(node_id)  # otherwise its portion would count it again
        self._read[node_id] = node

    def __delitem__(self, node_id: ua.NodeId) -> None:
        self[node_id]  # otherwise it would come back with its portion
        del self._read[node_id]

    def __iter__(self) -> Iterator[ua.NodeId]:
        self._take_all()
        return iter(self._read)

    def __len__(self) -> int:
        # without reading: `TypeTree` asks at every Browse, and no turn of the loop may be long
        unread = sum(len(portion.node_ids) for portion in self._unread.values())
        return len(self._read) + unread

    def _take_all(self) -> None:
        for number in list(self._unread):
            self._take(number)

    def _take(self, number: int) -> None:
        portion = zlib.decompress(self._unread.pop(number).nodes)
        for node_id, node in pickle.loads(portion).items():  # noqa: S301 - our own file in our own folder
            self._read.setdefault(node_id, node)


class QuickInternalServer(InternalServer):  # type: ignore[misc]
    """asyncua's inner server; its standard nodes are built once and then read from a file."""

    async def load_standard_address_space(self, shelf_file: Path | None = None) -> None:
        """Fill the address space; `shelf_file` is where asyncua itself would keep the nodes."""
        shelf = Shelf(SHELF)
        name = f"standard_nodes-{version('asyncua')}.pickle"
        kept = shelf.get(name)
        if kept is not None:
            # another version of ours may have kept them in another form
            with contextlib.suppress(Exception):
                self.aspace._nodes = Nodes(pickle.loads(kept))  # noqa: S301 - whole, and our own
                return
        with _no_collection():
            await super().load_standard_address_space(shelf_file)
            _share(self.aspace._nodes)
            portions = await asyncio.to_thread(_portions, self.aspace._nodes)
            shelf.put(name, pickle.dumps(portions, -1))


def _portions(nodes: dict[ua.NodeId, Any]) -> list[Portion]:
    every = list(nodes.items())
    portions = []
    for first in range(0, len(every), NODES_PER_PORTION):
        some = dict(every[first : first + NODES_PER_PORTION])
        pickled = io.BytesIO()
        _Pickler(pickled, -1).dump(some)
        portions.append(
            Portion(
                tuple((key.NamespaceIndex, key.Identifier) for key in some),
                zlib.compress(pickled.getvalue()),
            )
        )
    return portions


class _Pickler(pickle.Pickler):
    """Writes an attribute as a call: reading it takes half the memory of object and state."""

    def reducer_override(self, part: Any) -> Any:
        if type(part) is AttributeValue:
            return (AttributeValue, (part.value,))
        return NotImplemented


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

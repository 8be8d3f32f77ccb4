"""A server's standard nodes: read from disk they are those that asyncua builds."""

import asyncio
import tracemalloc

import pytest
from asyncua import ua

from hilserver.opcua import standard_nodes
from hilserver.opcua.standard_nodes import QuickInternalServer, nodes_file


def described(server):
    """All nodes of a server, comparable."""
    return {
        node_id: (
            {attribute: held.value for attribute, held in node.attributes.items()},
            node.references,
        )
        for node_id, node in server.aspace._nodes.items()
    }


async def loaded():
    server = QuickInternalServer()
    await server.load_standard_address_space()
    return server


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """What asyncua builds, and what is written of it."""
    folder = tmp_path_factory.mktemp("built")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(standard_nodes, "cache_folder", lambda _: folder)
        return described(asyncio.run(loaded())), nodes_file().read_bytes()


@pytest.fixture(autouse=True)
def cache(built, tmp_path, monkeypatch):
    monkeypatch.setattr(standard_nodes, "cache_folder", lambda _: tmp_path)
    nodes_file().write_bytes(built[1])


async def test_what_is_read_is_what_asyncua_builds(built):
    tracemalloc.start()
    try:
        read = await loaded()
        kept, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(built[0]) > 5000
    assert described(read) == built[0]
    assert peak < 1.2 * kept  # in one piece it took three times of what stays


async def test_equal_attributes_take_memory_once_and_values_of_variables_are_their_own():
    nodes = (await loaded()).aspace._nodes.values()
    places = [item for node in nodes for item in node.attributes.items()]
    kept = {id(place.value) for _, place in places}
    assert len(kept) < len(places) / 3
    values = [
        id(place.value)
        for attribute, place in places
        if attribute == ua.AttributeIds.Value
    ]
    assert len(set(values)) == len(values) > 1000


async def test_a_damaged_file_is_written_anew(built):
    nodes_file().write_bytes(built[1][:-100])
    assert described(await loaded()) == built[0]
    assert nodes_file().read_bytes() == built[1]


async def test_a_folder_that_cannot_be_written_costs_only_time(
    built, tmp_path, monkeypatch
):
    nodes_file().unlink()
    monkeypatch.setattr(standard_nodes, "cache_folder", lambda _: tmp_path / "missing")
    assert described(await loaded()) == built[0]
    assert list(tmp_path.iterdir()) == []

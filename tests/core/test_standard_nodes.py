"""A server's standard nodes: read from disk they are those that asyncua builds."""

import tracemalloc

import pytest

from hilserver.core import standard_nodes
from hilserver.core.standard_nodes import QuickInternalServer, nodes_file


@pytest.fixture(autouse=True)
def empty_cache(tmp_path, monkeypatch):
    monkeypatch.setattr(standard_nodes, "cache_dir", lambda: tmp_path)


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


async def test_what_is_read_is_what_asyncua_builds():
    built = described(await loaded())
    assert nodes_file().stat().st_size > 1_000_000
    read = await loaded()
    assert len(built) > 5000
    assert described(read) == built


async def test_a_damaged_file_is_written_anew():
    built = await loaded()
    whole = nodes_file().read_bytes()
    for damaged in (b"\x80\x05K\x01garbage", whole[:-100]):
        nodes_file().write_bytes(damaged)
        assert described(await loaded()) == described(built)
        assert nodes_file().read_bytes() == whole


async def test_reading_takes_hardly_more_memory_than_what_is_read():
    await loaded()
    tracemalloc.start()
    try:
        server = await loaded()
        kept, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(server.aspace._nodes) > 5000
    assert peak < 1.2 * kept


async def test_a_folder_that_cannot_be_written_costs_only_time(tmp_path, monkeypatch):
    monkeypatch.setattr(standard_nodes, "cache_dir", lambda: tmp_path / "missing")
    server = await loaded()
    assert len(server.aspace._nodes) > 5000
    assert list(tmp_path.iterdir()) == []

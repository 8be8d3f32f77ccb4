"""A server's standard nodes: read from disk they are those that asyncua builds."""

import asyncio
import pickle
import tracemalloc

import pytest
from asyncua import ua

from hilserver.cache import Shelf
from hilserver.opcua.browsing import TypeTree
from hilserver.opcua.server import HardenedServer
from hilserver.opcua.standard_nodes import SHELF, QuickInternalServer

ROOT, TYPES = ua.NodeId(ua.ObjectIds.RootFolder), ua.NodeId(ua.ObjectIds.TypesFolder)
PROGRAM = ua.NodeId(ua.ObjectIds.ProgramStateMachineType)


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
        patch.setenv("HILSERVER_CACHE_DIR", str(folder))
        nodes = described(asyncio.run(loaded()))
    (file,) = (folder / "opcua").iterdir()
    return nodes, file.name, file.read_bytes()


@pytest.fixture(autouse=True)
def file(built, tmp_path, monkeypatch):
    """What was written, in a cache of the test's own."""
    monkeypatch.setenv("HILSERVER_CACHE_DIR", str(tmp_path))
    file = tmp_path / "opcua" / built[1]
    file.parent.mkdir()
    file.write_bytes(built[2])
    return file


async def test_what_is_read_is_what_asyncua_builds(built):
    tracemalloc.start()
    try:
        read = await loaded()
        described_read = len([*read.aspace._nodes])
        kept, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert described_read == len(built[0]) > 5000
    assert described(read) == built[0]
    assert peak < 1.2 * kept  # in one piece it took three times of what stays


async def test_a_start_reads_only_what_it_needs():
    server = HardenedServer()
    await server.init()
    nodes = server.iserver.aspace._nodes
    unread = nodes.n_unread
    assert unread > 60
    # what a client asks for is there all the same, one portion at a time
    name = nodes[PROGRAM].attributes[ua.AttributeIds.BrowseName].value.Value.Value.Name
    assert name == "ProgramStateMachineType"
    assert nodes.n_unread == unread - 1
    n_nodes = len(nodes)
    assert n_nodes > 5000
    assert nodes.n_unread == unread - 1
    assert len([*nodes]) == n_nodes == len(nodes)
    assert nodes.n_unread == 0


async def test_a_browse_reads_a_few_portions_and_not_all_in_one_turn():
    server = HardenedServer()
    await server.init()
    nodes = server.iserver.aspace._nodes
    unread = nodes.n_unread
    types = TypeTree(server.iserver.aspace)
    assert len(types.closure(ua.NodeId(ua.ObjectIds.HierarchicalReferences))) > 10
    assert nodes.n_unread > unread / 2


async def test_what_is_no_node_id_is_no_node():
    nodes = (await loaded()).aspace._nodes
    assert [nodes.get(literal) for literal in ("abc", 7, None)] == [None] * 3


async def test_a_node_is_what_was_last_done_to_it_whenever_its_portion_is_read():
    nodes = (await loaded()).aspace._nodes
    other = object()
    nodes[ROOT] = other
    del nodes[TYPES]
    assert nodes[ua.NodeId(ua.ObjectIds.ObjectsFolder)] is not other
    assert nodes[ROOT] is other
    assert TYPES not in nodes
    assert nodes.get(TYPES) is None
    with pytest.raises(KeyError):
        nodes[ua.NodeId("ours", 2)]
    assert ROOT in [*nodes]
    assert TYPES not in [*nodes]


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


@pytest.mark.long
async def test_a_damaged_file_is_written_anew(built, file):
    """In every run `test_cache.py` damages files of a shelf."""
    file.write_bytes(built[2][:-100])
    assert described(await loaded()) == built[0]
    assert file.read_bytes() == built[2]


async def test_what_another_version_has_kept_is_written_anew(built, file):
    Shelf(SHELF).put(file.name, pickle.dumps({"nodes": 1}))
    assert len((await loaded()).aspace._nodes) == len(built[0])
    assert file.read_bytes() == built[2]


async def test_a_folder_that_cannot_be_written_costs_only_time(
    built, tmp_path, monkeypatch
):
    for name in ("HILSERVER_CACHE_DIR", "TMPDIR"):
        (tmp_path / name).write_text("", encoding="ascii")
        monkeypatch.setenv(name, str(tmp_path / name))
    assert described(await loaded()) == built[0]
    assert {path.name for path in tmp_path.iterdir()} == {
        "opcua",
        "HILSERVER_CACHE_DIR",
        "TMPDIR",
    }

"""Requests in portions: what a request has no time left for is answered so."""

import time
from typing import Any

import pytest
from asyncua import ua

from benchmarks.wire import Wire
from hilserver.opcua import processor, reading
from tests.io.opcua_server.rig import Rig

pytestmark = pytest.mark.asyncio(loop_scope="module")


async def continuation_point(wire: Wire) -> bytes:
    request = ua.BrowseRequest()
    request.Parameters.RequestedMaxReferencesPerNode = 1
    request.Parameters.NodesToBrowse = [
        ua.BrowseDescription(NodeId=ua.NodeId("robot", 2), ResultMask=63)
    ]
    return bytes(
        (await wire.ask(request, ua.BrowseResponse)).Results[0].ContinuationPoint
    )


async def browse_next(wire: Wire, point: bytes) -> Any:
    request = ua.BrowseNextRequest()
    request.Parameters = ua.BrowseNextParameters(False, [point])
    return (await wire.ask(request, ua.BrowseNextResponse)).Parameters.Results[0]


async def test_browse_next_without_time_is_answered_so_and_keeps_its_place(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with Wire(rig.server.url) as wire:
        await wire.log_in()
        point = await continuation_point(wire)
        with monkeypatch.context() as patched:
            patched.setattr(processor, "REQUEST_S", -1.0)
            assert (await browse_next(wire, point)).StatusCode.name == "BadTimeout"
        result = await browse_next(wire, point)
        assert result.StatusCode.name == "Good"
        assert len(result.References) == 1


async def test_a_stall_of_the_computer_is_no_work_of_a_request(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before, a read of two values on a busy computer had no second value."""
    look_up = reading.value_at

    def stalled(*at: Any) -> ua.DataValue:
        time.sleep(0.1)
        return look_up(*at)

    monkeypatch.setattr(reading, "value_at", stalled)
    monkeypatch.setattr(processor, "REQUEST_S", 0.05)
    request = ua.ReadRequest()
    node_id, value = ua.NodeId("sim.tick", 2), ua.AttributeIds.Value
    request.Parameters.NodesToRead = [ua.ReadValueId(node_id, value)] * 3
    async with Wire(rig.server.url) as wire:
        await wire.log_in()
        results = (await wire.ask(request, ua.ReadResponse)).Results
    assert "BadTimeout" not in [result.StatusCode.name for result in results]

"""What hostile clients tried: numbers that are none, more than their share, others' places."""

import math
from collections.abc import AsyncIterator

import pytest
import pytest_asyncio
from asyncua import ua

from hilserver.bench.wire import Wire
from hilserver.faults.model import parse_faults
from tests.io.opcua_server.rig import Rig, connected

pytestmark = pytest.mark.asyncio(loop_scope="module")
NO_NUMBERS = (math.nan, math.inf, -math.inf)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def rig(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Rig]:
    rig = Rig(tmp_path_factory.mktemp("snapshots"))
    await rig.server.start()
    rig.control.started()
    rig.gate.request("opcua", "opcua")
    rig.tick()
    yield rig
    await rig.close()


# --- numbers that are none ------------------------------------------------------------------------


@pytest.mark.parametrize("asked_ms", [*NO_NUMBERS, 1e300, -1.0])
async def test_a_session_ends_whatever_time_out_was_asked_for(rig: Rig, asked_ms: float) -> None:
    async with Wire(rig.server.url) as wire:
        await wire.greet()
        await wire.open()
        request = ua.CreateSessionRequest()
        request.Parameters.RequestedSessionTimeout = asked_ms
        response = await wire.ask(request, ua.CreateSessionResponse)
        assert 1_000 <= response.Parameters.RevisedSessionTimeout <= 120_000


@pytest.mark.parametrize("asked", NO_NUMBERS)
async def test_intervals_that_are_no_numbers_are_revised(rig: Rig, asked: float) -> None:
    async with Wire(rig.server.url) as wire:
        await wire.log_in()
        create = ua.CreateSubscriptionRequest()
        create.Parameters.RequestedPublishingInterval = asked
        made = (await wire.ask(create, ua.CreateSubscriptionResponse)).Parameters
        assert 5.0 <= made.RevisedPublishingInterval <= 3_600_000.0
        items = ua.CreateMonitoredItemsRequest()
        items.Parameters.SubscriptionId = made.SubscriptionId
        item = ua.MonitoredItemCreateRequest()
        item.ItemToMonitor = ua.ReadValueId(
            NodeId=ua.NodeId("sim.tick", 2), AttributeId=ua.AttributeIds.Value
        )
        item.RequestedParameters.SamplingInterval = asked
        items.Parameters.ItemsToCreate = [item]
        (result,) = (await wire.ask(items, ua.CreateMonitoredItemsResponse)).Results
        assert 0.0 <= result.RevisedSamplingInterval <= 3_600_000.0
        item.RequestedParameters.Filter = ua.DataChangeFilter(
            Trigger=ua.DataChangeTrigger.StatusValue,
            DeadbandType=ua.DeadbandType.Absolute,
            DeadbandValue=asked,
        )
        (result,) = (await wire.ask(items, ua.CreateMonitoredItemsResponse)).Results
        assert result.StatusCode.name == "BadDeadbandFilterInvalid"


@pytest.mark.parametrize("number", NO_NUMBERS)
async def test_methods_take_no_number_that_is_none(rig: Rig, number: float) -> None:
    async with connected(rig) as client:
        double = ua.Variant(number, ua.VariantType.Double)
        answer = await client.call("SetPose", double, double, double)
        assert answer.StatusCode.name == "BadInvalidArgument"
        signal = ua.Variant("wheel.fl.speed_rpm", ua.VariantType.String)
        answer = await client.call("Force", signal, double)
        assert answer.StatusCode.name in ("BadInvalidArgument", "BadNotImplemented")


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999"])
async def test_injected_faults_have_no_number_that_is_none(number: str) -> None:
    with pytest.raises(ValueError, match=r"offset|valid JSON"):
        parse_faults(f'{{"fault": "bias", "signal": "pose.x_m", "offset": {number}}}')

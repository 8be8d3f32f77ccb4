"""ServerStatus, ServiceLevel, diagnostics."""

import asyncio
import math
from datetime import UTC, datetime

import pytest
from asyncua import ua

from hilserver.io.opcua_server.server_status import service_level
from hilserver.signals import State
from tests.io.opcua_server.rig import Rig, RobotClient

pytestmark = pytest.mark.asyncio(loop_scope="module")


async def states(rig: Rig, client: RobotClient) -> tuple[int, int, int]:
    rig.server.publish_diagnostics()
    kinds = ua.ObjectIds
    status = await client.get_node(kinds.Server_ServerStatus).read_value()
    state = await client.get_node(kinds.Server_ServerStatus_State).read_value()
    level = await client.get_node(kinds.Server_ServiceLevel).read_value()
    assert status.State == state
    return state, level, status.StartTime.year


async def test_state_and_service_level(rig: Rig, client: RobotClient) -> None:
    suspended, running = ua.ServerState.Suspended, ua.ServerState.Running
    assert (await states(rig, client))[:2] == (suspended, 1)
    rig.control.started()
    assert await states(rig, client) == (running, 255, datetime.now(UTC).year)
    rig.tables["audit"] = {"kernel": {"ok": False, "found": "generic"}}
    assert (await states(rig, client))[:2] == (running, 240)
    rig.tables["peers"] = {"plc": {"connected": False}}
    assert (await states(rig, client))[:2] == (running, 199)
    rig.control.pause()
    assert (await states(rig, client))[:2] == (suspended, 150)
    rig.control.start()
    rig.control.stop()
    assert (await states(rig, client))[:2] == (running, 100)
    rig.control.reset()
    rig.tables["audit"], rig.tables["peers"] = {}, {}


async def test_service_level_falls_with_every_trouble() -> None:
    good, bad = {"a": {"ok": True}}, {"a": {"ok": False}}
    away, here = {"p": {"connected": False}}, {"p": {"connected": True}}
    levels = [
        service_level(State.RUNNING, here, good),
        service_level(State.RUNNING, here, bad),
        service_level(State.RUNNING, away, bad),
        service_level(State.PAUSED, here, good),
        service_level(State.SAFE, here, good),
        service_level(State.STARTING, here, good),
        service_level(State.STOPPING, here, good),
    ]
    assert levels == sorted(levels, reverse=True)
    assert len(set(levels)) == len(levels)


async def test_current_time_is_live(client: RobotClient) -> None:
    node = client.get_node(ua.ObjectIds.Server_ServerStatus_CurrentTime)
    before = datetime.now(UTC)
    first, second = await node.read_value(), await node.read_value()
    assert before <= first < second <= datetime.now(UTC)


async def until_slices_show(rig: Rig, client: RobotClient, overruns: int) -> None:
    """Slices are shown once a second."""
    async with asyncio.timeout(120):
        while True:
            rig.server.publish_diagnostics()
            found = (await client.data_value("slices.plant.overruns")).Value
            if found is not None and found.Value == overruns:
                return
            await asyncio.sleep(0.02)


async def test_figures_appear_and_change(rig: Rig, client: RobotClient) -> None:
    rig.tables["slices"] = {
        "plant": {
            "overruns": 3,
            "wake_p99_us": 12.5,
            "worst_at_s": None,
            "margin_min_tick": None,
            "cause": "stolen",
            "late": True,
        }
    }
    await until_slices_show(rig, client, 3)
    folder = "slices.plant"
    kinds = {"overruns": 3, "wake_p99_us": 12.5, "cause": "stolen", "late": True}
    for figure, value in kinds.items():
        found = await client.read(f"{folder}.{figure}")
        assert (found, type(found)) == (value, type(value))
    for figure in ("worst_at_s", "margin_min_tick"):
        code = (await client.data_value(f"{folder}.{figure}")).StatusCode
        assert code.name == "BadWaitingForInitialData"
    rig.tables["slices"]["plant"] |= {
        "overruns": 4,
        "worst_at_s": 1,
        "wake_p99_us": math.inf,
    }
    rig.tables["slices"]["plant"]["margin_min_tick"] = 7
    await until_slices_show(rig, client, 4)
    assert await client.read(f"{folder}.worst_at_s") == 1.0
    tick = (await client.data_value(f"{folder}.margin_min_tick")).Value
    assert (tick.Value, tick.VariantType) == (7, ua.VariantType.Int64)
    assert await client.read(f"{folder}.wake_p99_us") == math.inf


async def test_a_figure_that_changes_its_type_breaks_nothing(
    rig: Rig, client: RobotClient
) -> None:
    for value, shown in (
        (1, 1),
        (math.nan, None),
        ("text", None),
        (2.0, 2),
        (None, None),
        (10**30, None),
    ):
        rig.tables["peers"] = {"a.b": {"figure": value}}
        rig.server.publish_diagnostics()
        found = await client.data_value("peers.a_b.figure")
        assert found.Value.Value == shown
        assert found.StatusCode.is_good() == (shown is not None)
    rig.tables["peers"] = {}


async def test_audit_items_are_booleans_with_details(
    rig: Rig, client: RobotClient
) -> None:
    rig.tables["audit"] = {
        "kernel": {"found": "generic", "remedy": "boot the rt kernel", "ok": False}
    }
    rig.server.publish_diagnostics()
    assert await client.read("audit.kernel") is False
    assert await client.read("audit.kernel.remedy") == "boot the rt kernel"
    assert await client.read("audit.opcua_access") is True
    rig.tables["audit"] = {}


async def test_figures_are_read_only(client: RobotClient) -> None:
    assert await client.write(("audit.opcua_access", True, ua.VariantType.Boolean)) == [
        "BadNotWritable"
    ]

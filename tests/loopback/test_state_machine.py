"""Commands over OPC UA: pause, step, stop, reset, snapshots, and who has control."""

import asyncio
import itertools
import math
from functools import partial

import pytest
import pytest_asyncio
from asyncua import ua

from hilserver.signals import State
from tests.loopback.rig import (
    call,
    column,
    configuration,
    double,
    frames,
    inbox,
    newest,
    run_ticks,
    running,
    take,
    text,
    uint32,
    wait_until,
)

pytestmark = pytest.mark.asyncio(loop_scope="module")

SAFE_RAMP_S = 0.3


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def robot(tmp_path_factory):
    config = configuration(plant={"safe_ramp_s": SAFE_RAMP_S})
    async with running(config, tmp_path_factory.mktemp("robot")) as pair:
        yield pair


@pytest_asyncio.fixture(loop_scope="module")
async def at_rest(robot):
    """Running, standing still, at tick 0, with OPC UA in control."""
    daemon, client = robot
    daemon.control.set_speed(1.0)
    daemon.gate.take("opcua")
    if daemon.control.state is State.SAFE:
        assert await call(client, "Reset") == "Good"
    assert await call(client, "Start") == "Good"
    assert await call(client, "Reset") == "Good"
    await run_ticks(daemon, 40)
    return daemon, client


async def forward(client, rpm):
    codes = await client.write_doubles(
        wheel__fl__setpoint_rpm=rpm,
        wheel__rl__setpoint_rpm=rpm,
        wheel__fr__setpoint_rpm=-rpm,
        wheel__rr__setpoint_rpm=-rpm,
    )
    assert codes == ["Good"] * 4


async def pause(daemon, client):
    assert await call(client, "Pause") == "Good"
    await daemon.scheduler.wait_paused()


async def test_step_advances_by_exactly_n_ticks_while_paused(at_rest):
    daemon, client = at_rest
    await pause(daemon, client)
    tick, head = daemon.scheduler.tick, daemon.image.head
    await wait_until(lambda: _reads(client, State.PAUSED))
    for n in (1, 7, 250):
        assert await call(client, "Step", uint32(n)) == "Good"
        await daemon.scheduler.wait_paused()
        tick, head = tick + n, head + n
        assert (daemon.scheduler.tick, daemon.image.head) == (tick, head)
        await wait_until(partial(_reads, client, tick - 1, "sim.tick"))
    assert await client.read("sim.state") == State.PAUSED
    assert await call(client, "Start") == "Good"
    await run_ticks(daemon, 40)
    await wait_until(lambda: _reads(client, State.RUNNING))


async def _reads(client, value, name="sim.state"):
    return await client.read(name) == value


async def test_step_is_refused_while_running(at_rest):
    daemon, client = at_rest
    result = await client.call("Step", uint32(1))
    assert result.StatusCode.name == "BadInvalidState"
    await pause(daemon, client)
    assert await call(client, "Step", uint32(0)) == "BadInvalidArgument"


async def test_written_values_are_visible_while_paused_and_latched_by_the_next_tick(
    at_rest,
):
    daemon, client = at_rest
    await pause(daemon, client)
    await forward(client, 12.0)
    assert await client.read("wheel.fl.setpoint_rpm") == 12.0
    first = daemon.image.head
    await call(client, "Step", uint32(3))
    await daemon.scheduler.wait_paused()
    assert column(daemon, "wheel.fl.setpoint_rpm", first) == [12.0] * 3


async def test_stop_ramps_to_zero_disables_the_drive_and_waits_for_reset(at_rest):
    daemon, client = at_rest
    async with inbox(client) as box:
        await forward(client, 60.0)
        await run_ticks(daemon, 500)
        first = daemon.image.head
        assert await call(client, "Stop") == "Good"
        await wait_until(lambda: box.has("safe_state", "stopped by command"))
        await run_ticks(daemon, 800)
        await wait_until(lambda: _reads(client, False, "drive.enable"))
    speeds = column(daemon, "wheel.fl.speed_rpm", first)
    commands = column(daemon, "internal.command", first)
    begin = commands.index(2.0)
    ramp = round(SAFE_RAMP_S * 1000)
    assert speeds[begin] == pytest.approx(60.0, abs=0.5)
    half = speeds[begin + ramp // 2]
    assert half == pytest.approx(30.0, abs=3.0), "halfway through the ramp"
    falling = itertools.pairwise(speeds[begin : begin + ramp])
    assert all(after <= before + 1e-9 for before, after in falling)
    assert max(abs(s) for s in speeds[begin + ramp + 200 :]) < 1.0
    data = await client.data_value("wheel.fl.speed_rpm")
    assert data.StatusCode.is_uncertain()
    assert await client.read("sim.state") == State.SAFE
    refused = {name: await call(client, name) for name in ("Start", "Pause")}
    assert refused == dict.fromkeys(("Start", "Pause"), "BadInvalidState")
    assert await call(client, "LoadSnapshot", text("any")) == "BadInvalidState"

    assert await call(client, "Reset") == "Good"
    await run_ticks(daemon, 100)
    await wait_until(lambda: _reads(client, State.RUNNING))
    await wait_until(lambda: _reads(client, True, "drive.enable"))
    assert await client.read("wheel.fl.setpoint_rpm") == 0.0
    assert (await client.data_value("wheel.fl.speed_rpm")).StatusCode.is_good()

    assert await client.write_doubles(wheel__fl__setpoint_rpm=12.0) == [
        "BadInvalidState"
    ]
    await wait_until(lambda: _reads(client, True, "control.waits_for_start"))
    async with inbox(client) as box:
        assert await call(client, "Start") == "Good"
        await wait_until(lambda: box.has("state", "Start() by anonymous"))
    await forward(client, 12.0)
    await wait_until(lambda: _reads(client, False, "control.waits_for_start"))


async def test_the_drive_stays_disabled_although_a_client_goes_on_writing(at_rest):
    daemon, client = at_rest
    await forward(client, 60.0)
    await run_ticks(daemon, 300)
    assert await call(client, "Stop") == "Good"
    await run_ticks(daemon, round(SAFE_RAMP_S * 1000) + 300)
    first = daemon.image.head
    for _ in range(10):
        await client.write(("drive.enable", True, ua.VariantType.Boolean))
        await forward(client, 60.0)
        await asyncio.sleep(0.02)
    await run_ticks(daemon, 50)
    assert set(column(daemon, "drive.enable", first)) == {0.0}
    assert max(abs(s) for s in column(daemon, "wheel.fl.speed_rpm", first)) < 1.0
    assert await call(client, "Reset") == "Good"
    first = await run_ticks(daemon, 200)
    assert max(abs(s) for s in column(daemon, "wheel.fl.speed_rpm", first)) < 1.0
    assert newest(daemon, "drive.enable") == 1.0


async def test_stop_works_while_paused(at_rest):
    daemon, client = at_rest
    await forward(client, 50.0)
    await run_ticks(daemon, 300)
    await pause(daemon, client)
    assert await call(client, "Stop") == "Good"
    await run_ticks(daemon, 700)
    assert abs(newest(daemon, "wheel.fl.speed_rpm")) < 1.0
    await wait_until(lambda: _reads(client, False, "drive.enable"))


async def test_a_snapshot_brings_everything_back(at_rest):
    daemon, client = at_rest
    await forward(client, 40.0)
    await run_ticks(daemon, 200)
    await pause(daemon, client)
    assert await call(client, "SaveSnapshot", text("here")) == "Good"
    tick, first = daemon.scheduler.tick, daemon.image.head
    await call(client, "Step", uint32(100))
    await daemon.scheduler.wait_paused()
    expected = [(f.tick, f.values.tobytes()) for f in frames(daemon, first)]

    await forward(client, -40.0)
    await call(client, "SetPose", double(5.0), double(5.0), double(1.0))
    await call(client, "Step", uint32(300))
    await daemon.scheduler.wait_paused()
    assert await call(client, "LoadSnapshot", text("here")) == "Good"
    assert daemon.scheduler.tick == tick
    first = daemon.image.head
    await call(client, "Step", uint32(100))
    await daemon.scheduler.wait_paused()
    assert [(f.tick, f.values.tobytes()) for f in frames(daemon, first)] == expected


async def test_clients_see_what_was_restored_while_the_daemon_is_paused(at_rest):
    daemon, client = at_rest
    await pause(daemon, client)
    await call(client, "SetPose", double(1.0), double(2.0), double(0.5))
    await call(client, "Step", uint32(20))
    await daemon.scheduler.wait_paused()
    seen = ("sim.tick", "pose.x_m", "pose.y_m", "pose.yaw_rad")
    before = daemon.image.latest()
    expected = [before.values[daemon.table.slot(name)] for name in seen]
    assert expected[1:3] == pytest.approx([1.0, 2.0], abs=0.01)
    assert await call(client, "SaveSnapshot", text("paused")) == "Good"
    await call(client, "SetPose", double(-3.0), double(-4.0), double(0.0))
    await call(client, "Step", uint32(20))
    await daemon.scheduler.wait_paused()

    assert await call(client, "LoadSnapshot", text("paused")) == "Good"
    for name, value in zip(seen, expected, strict=True):
        await wait_until(partial(_reads, client, value, name))
    assert await call(client, "Reset") == "Good"
    for name in seen:
        await wait_until(partial(_reads, client, 0.0, name))
    assert daemon.scheduler.paused


async def test_a_snapshot_that_is_not_there_or_has_a_path(at_rest):
    _, client = at_rest
    assert await call(client, "LoadSnapshot", text("nowhere")) == "BadInvalidState"
    assert await call(client, "SaveSnapshot", text("../escape")) == "BadInvalidArgument"


async def test_control_is_taken_by_priority_and_refusals_say_so(at_rest):
    daemon, client = at_rest
    assert await take(client, "peer") == "Good"
    async with inbox(client) as box:
        assert await client.write_doubles(wheel__fl__setpoint_rpm=5.0) == [
            "BadUserAccessDenied"
        ]
        await wait_until(lambda: box.has("setpoint_refused", "'peer' has control"))
        assert await take(client, "opcua") == "Good"
        await wait_until(
            lambda: box.has("state", "control passes from 'peer' to 'opcua'")
        )
    assert await take(client, "somebody") == "BadOutOfRange"
    assert await client.write_doubles(wheel__fl__setpoint_rpm=5.0) == ["Good"]
    daemon.gate.take("page")
    assert await take(client, "opcua") == "BadUserAccessDenied"
    await wait_until(lambda: _reads(client, "page", "control.source"))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 90.1, -90.1])
async def test_a_bad_value_never_gets_into_a_frame(at_rest, value):
    daemon, client = at_rest
    first = daemon.image.head
    assert await client.write_doubles(wheel__fl__setpoint_rpm=value) == [
        "BadOutOfRange"
    ]
    await run_ticks(daemon, 20)
    assert set(column(daemon, "wheel.fl.setpoint_rpm", first)) == {0.0}


async def test_a_tenth_of_the_speed_takes_ten_times_as_long(at_rest):
    daemon, client = at_rest
    daemon.control.set_speed(0.1)
    await run_ticks(daemon, 2)
    begin = await run_ticks(daemon, 20)
    first, last = daemon.image.frame(begin), daemon.image.latest()
    assert last.planned_ns - first.planned_ns >= (last.tick - first.tick) * 10_000_000
    with pytest.raises(ValueError, match="speed factor"):
        daemon.control.set_speed(0.0)
    daemon.control.set_speed(1.0)
    assert await client.read("sim.state") == State.RUNNING

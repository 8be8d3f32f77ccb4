"""A blocked event loop: the plant goes to the safe state by itself."""

import asyncio
import time
from contextlib import contextmanager

import pytest
import pytest_asyncio

from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.image import press_stop
from hilserver.signals import State
from tests.loopback.rig import (
    call,
    column,
    configuration,
    frames,
    inbox,
    run_ticks,
    running,
    scrape,
    wait_until,
)

pytestmark = pytest.mark.asyncio(loop_scope="module")

TIMEOUT_S = 0.4
TRIES = 40
PATIENT = 10
"""So many times longer while no test is about silence: reading frames holds up this loop, too."""


@contextmanager
def watched(daemon):
    """Within this the event loop may be silent for `TIMEOUT_S` only."""
    control = daemon.image.control
    patient = control.heartbeat_limit
    control.heartbeat_limit = patient // PATIENT
    try:
        yield
    finally:
        control.heartbeat_limit = patient


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def robot():
    config = configuration(
        # As few events a second as users get: on a slow computer this blocked loop reports hundreds
        # of late ticks at once, more than a subscription keeps, and the safe state is the oldest.
        opcua={"endpoint": "opc.tcp://127.0.0.1:0/hilserver"},
        plant={"safe_ramp_s": 0.2},
        scheduler={"communication_timeout_ms": PATIENT * TIMEOUT_S * 1e3},
    )
    async with running(config) as pair:
        yield pair


async def test_a_blocked_event_loop_stops_the_robot(robot):
    daemon, client = robot
    async with inbox(client) as box:
        await client.write_doubles(wheel__fl__setpoint_rpm=60.0)
        await run_ticks(daemon, 400)
        begin_ns = time.monotonic_ns()
        with watched(daemon):
            time.sleep(TIMEOUT_S + 0.6)  # noqa: ASYNC251 - this is the fault
        end_ns = time.monotonic_ns()
        blocked = [f for f in frames(daemon) if begin_ns < f.planned_ns < end_ns]
        slot = daemon.table.slot
        safe = [f for f in blocked if f.values[slot("internal.command")] == 2.0]
        assert safe, "the plant waited for the event loop"
        silent_s = (safe[0].planned_ns - begin_ns) * 1e-9
        assert silent_s > TIMEOUT_S - 0.1, "it went too early"
        assert abs(blocked[-1].values[slot("wheel.fl.speed_rpm")]) < 1.0, (
            "stopped while blocked"
        )
        await wait_until(lambda: daemon.control.state is State.SAFE)
        assert "did not answer in time" in daemon.control.reason
        await wait_until(lambda: box.has("safe_state", "did not answer"))
    assert 'hil_state{state="safe"} 1.0' in await scrape(daemon)
    assert await call(client, "Reset") == "Good"
    assert await call(client, "Start") == "Good"
    first = await run_ticks(daemon, 300)
    assert daemon.control.state is State.RUNNING
    assert set(column(daemon, "internal.command", first + 50)) == {0.0}


async def test_stop_is_obeyed_by_a_daemon_whose_event_loop_stands(robot):
    daemon, client = robot
    await client.write_doubles(wheel__fl__setpoint_rpm=60.0)
    first = await run_ticks(daemon, 200)
    pressed_ns = press_stop(daemon.image.name)
    time.sleep(0.2)  # noqa: ASYNC251 - nobody is there
    slot = daemon.table.slot("internal.command")
    begin = next(f for f in frames(daemon, first) if f.values[slot] == 2.0)
    assert begin.planned_ns - pressed_ns < 50_000_000
    await wait_until(lambda: daemon.control.state is State.SAFE)
    assert daemon.control.reason == "stopped by command"
    assert await call(client, "Reset") == "Good"
    assert await call(client, "Start") == "Good"


async def test_a_pause_is_no_silence(robot):
    daemon, client = robot
    with watched(daemon):
        assert await call(client, "Pause") == "Good"
        await asyncio.sleep(2 * TIMEOUT_S)
        assert await call(client, "Start") == "Good"
        await run_ticks(daemon, 150)
    assert daemon.control.state is State.RUNNING


async def test_the_time_out_is_real_time_at_every_speed(robot):
    daemon, _ = robot
    limit = daemon.image.control.heartbeat_limit
    daemon.control.set_speed(50.0)
    assert daemon.image.control.heartbeat_limit == 50 * limit
    time.sleep(TIMEOUT_S)  # noqa: ASYNC251 - a hiccup: more ticks than the time-out had before
    await asyncio.sleep(0.2)
    daemon.control.set_speed(1.0)
    assert daemon.control.state is State.RUNNING


async def test_the_heartbeat_goes_on_in_a_pause_as_often_as_the_time_out_needs():
    config = configuration(
        opcua={"enabled": False}, scheduler={"communication_timeout_ms": 80.0}
    )
    async with Daemon(assemble_config(config)) as daemon:
        # the beats count here, not who watches them
        daemon.image.control.heartbeat_limit = 0
        daemon.control.pause()
        seen = []
        while (
            len(seen) < TRIES and max(seen, default=0) <= 10
        ):  # others may have the cores
            before = daemon.image.control.heartbeat
            await asyncio.sleep(0.5)
            seen.append(daemon.image.control.heartbeat - before)
        assert max(seen) > 10, seen

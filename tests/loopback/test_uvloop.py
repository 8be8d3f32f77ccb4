"""The doors on uvloop, on which the daemon serves: one daemon, and one visit through each."""

import asyncio
import os
import sys
from pathlib import Path

import pytest
import snap7
import uvloop

from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.io.shield.protocol import ShieldCommand, request
from tests.io.foxglove.test_endpoint import Viewer
from tests.io.opcua_server.rig import RobotClient
from tests.io.ros2.rig import claimed_domain
from tests.io.s7.rig import DRIVE
from tests.loopback.rig import configuration, scrape, wait_until

PROGRAM = Path(__file__).parents[2] / "examples" / "ros2-client" / "drive.py"


@pytest.fixture(scope="module")
def runner():
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        yield runner


@pytest.fixture(scope="module")
def domain():
    with claimed_domain() as domain:
        yield domain


@pytest.fixture(scope="module")
def daemon(runner, domain, tmp_path_factory):
    config = configuration(
        foxglove={"enabled": True, "port": 0},
        s7={"server": {"port": 0, "blocks": {1: DRIVE}}},
        ros2={"enabled": True, "domain": domain},
        shield={
            "enabled": True,
            "link": str(tmp_path_factory.mktemp("line") / "shield"),
        },
        control={"source": "opcua"},
    )
    daemon = Daemon(assemble_config(config))
    runner.run(daemon.__aenter__())
    yield daemon
    runner.run(daemon.__aexit__(None, None, None))


async def opcua(daemon):
    client = RobotClient(daemon.part("opcua").url)
    await client.connect()
    await client.write_doubles(**{"wheel.fl.setpoint_rpm": 20.0})
    await wait_until(lambda: daemon.gate.newest("wheel.fl.setpoint_rpm") == 20.0)
    await client.disconnect()


async def metrics(daemon):
    assert "\n# TYPE hil_" in await scrape(daemon)


async def foxglove(daemon):
    async with Viewer(daemon.part("foxglove").url) as viewer:
        assert await viewer.subscribe("/hilserver/frame", 1)


async def s7(daemon):
    port = int(daemon.part("s7").address.rpartition(":")[2])

    def read():
        client = snap7.client.Client()
        client.connect("127.0.0.1", 0, 1, port)
        block = client.db_read(1, 0, 12)
        client.disconnect()
        return int.from_bytes(block[8:12], "big")

    assert await asyncio.to_thread(read) > 0


async def ros2(daemon):
    own = {**os.environ, "ROS_DOMAIN_ID": str(daemon.config.ros2.domain)}
    process = await asyncio.create_subprocess_exec(
        sys.executable, PROGRAM, env=own, stdout=asyncio.subprocess.PIPE
    )
    text, _ = await process.communicate()
    assert process.returncode == 0, "it ends with 1 if nobody answers"
    assert b"turned with" in text


async def shield(daemon):
    part = daemon.part("shield")
    line = os.open(part.address, os.O_RDWR | os.O_NOCTTY)
    try:
        os.write(line, request(ShieldCommand.ENABLE))
        answer = await asyncio.to_thread(os.read, line, 32)
    finally:
        os.close(line)
    assert answer


@pytest.mark.parametrize(
    "visit", [opcua, metrics, foxglove, s7, ros2, shield], ids=lambda v: v.__name__
)
def test_a_door_serves_on_uvloop(runner, daemon, visit):
    runner.run(asyncio.wait_for(visit(daemon), 120.0))

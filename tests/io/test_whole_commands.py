"""A command is whole or not at all, whichever door it comes through: one wheel of four is wrong."""

import asyncio
import json
import math
import struct
import time
from itertools import count

import numpy as np
import pytest
import pytest_asyncio
import snap7

from hilserver.config.peers import PeerConfig
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.io.link_status import PeerStatus
from hilserver.io.peer_link.intake import Intake
from hilserver.io.peer_link.samples import judge_value
from hilserver.io.shared_memory.inputs import COUNTER
from hilserver.io.source import Source
from hilserver.plant.layout import WHEELS
from tests.io.foxglove.test_endpoint import Viewer
from tests.io.opcua_server.rig import RobotClient
from tests.loopback.rig import configuration, wait_until

pytestmark = pytest.mark.asyncio(loop_scope="module")
SETPOINTS = [f"wheel.{wheel}.setpoint_rpm" for wheel in WHEELS]
DB = [{"signal": name, "at": 4 * place} for place, name in enumerate(SETPOINTS)]
GROUP = {"name": "drive", "signals": ["wheel.*.setpoint_rpm"], "writable": True}


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def daemon():
    config = configuration(
        foxglove={"enabled": True, "port": 0},
        s7={"server": {"port": 0, "blocks": {1: DB}}},
        shared_memory={"grants": ["command"]},
        edge={"enabled": True, "host": "127.0.0.1", "port": 1, "groups": [GROUP]},
        control={"source": "opcua"},
    )
    async with Daemon(assemble_config(config)) as daemon:
        yield daemon


async def opcua(daemon):
    daemon.gate.take("opcua")
    client = RobotClient(daemon.part("opcua").url)
    await client.connect()

    async def send(values):
        await client.write_doubles(**dict(zip(SETPOINTS, values, strict=True)))

    return send, client.disconnect


async def foxglove(daemon):
    daemon.gate.take("page")
    viewer = await Viewer(daemon.part("foxglove").url).__aenter__()
    await viewer.advertise(1, "/hilserver/set", "json")

    async def send(values):
        text = json.dumps(dict(zip(SETPOINTS, values, strict=True)))
        await viewer.publish(1, text.encode())

    await send([0.0] * 4)  # a hand lets go before it drives
    await wait_until(lambda: daemon.gate.newest(SETPOINTS[0]) == 0.0, 30.0)
    return send, lambda: viewer.__aexit__(None, None, None)


async def s7(daemon):
    daemon.gate.take("peer")
    client = snap7.client.Client()
    port = int(daemon.part("s7").address.rpartition(":")[2])

    def write(values):
        client.connect("127.0.0.1", 0, 1, port)
        try:
            client.db_write(1, 0, bytearray(struct.pack(">4f", *values)))
        except snap7.error.S7ProtocolError:
            assert values[3] not in (5.0, 9.0)
        finally:
            client.disconnect()

    async def send(values):
        await asyncio.to_thread(write, values)

    return send, nothing


async def shared_memory(daemon):
    daemon.gate.take("peer")
    inputs = daemon.part("shared_memory")._inputs
    places = [[s.name for s in inputs._signals].index(name) for name in SETPOINTS]
    numbers = count(2, 2)

    async def send(values):
        inputs._values[:] = np.nan
        inputs._values[places] = values
        inputs._words[COUNTER] = next(numbers)

    return send, nothing


async def databus(daemon):
    daemon.gate.take("peer")
    edge = daemon.part("edge")
    [collection] = edge._collections
    ids = {signal.name: number for number, signal in collection.inputs.items()}

    async def send(values):
        pairs = zip(SETPOINTS, values, strict=True)
        points = [{"id": ids[name], "val": value} for name, value in pairs]
        edge._write(collection, json.dumps({"vals": points}).encode())

    return send, nothing


async def peer(daemon):
    daemon.gate.take("peer")
    nodes = {f"ns=1;s={name}": name for name in SETPOINTS}
    config = PeerConfig(name="plc", endpoint="opc.tcp://127.0.0.1:1", read=nodes)
    source = Source(
        config.driver,
        "plc",
        PeerStatus("plc"),
        daemon.gate,
        daemon.core.events.publish,
        fresh=lambda: "fresh",
        commanding=SETPOINTS,
    )
    intake = Intake(config, source, lambda now_ns: now_ns)

    async def send(values):
        samples = [
            (node, judge_value(value))
            for node, value in zip(nodes, values, strict=True)
        ]
        intake.receive(samples, time.monotonic_ns())
        source.watch(time.monotonic_ns())

    return send, nothing


async def nothing():
    """Leave nothing behind."""


CASES = [
    *((door, 400.0) for door in (opcua, foxglove, s7, shared_memory, databus, peer)),
    *((door, math.nan) for door in (opcua, s7, shared_memory, peer)),
]


@pytest.mark.parametrize(
    ("door", "wrong"), CASES, ids=[f"{door.__name__}-{wrong}" for door, wrong in CASES]
)
async def test_of_four_wheels_none_acts_where_one_is_wrong(
    daemon, monkeypatch, door, wrong
):
    gate, seen, acted = daemon.gate, [], []
    write = gate.write

    def noting(source, values, **more):
        refused = write(source, values, **more)
        seen.append(dict(values))
        acted.append([values[n] for n in SETPOINTS if n in values and n not in refused])
        return refused

    monkeypatch.setattr(gate, "write", noting)
    gate.end()
    send, close = await door(daemon)
    try:
        await send([9.0] * 4)
        await wait_until(lambda: [9.0] * 4 in acted, 30.0)
        acted.clear(), seen.clear()
        await send([20.0, 20.0, 20.0, wrong])
        await wait_until(lambda: any(20.0 in group.values() for group in seen), 30.0)
        assert not any(acted)
        await send([5.0] * 4)
        await wait_until(lambda: [5.0] * 4 in acted, 30.0)
    finally:
        await close()

"""The daemon with data blocks, and a controller of another make (the server of python-snap7)."""

import socket
import struct
from contextlib import asynccontextmanager, contextmanager

import snap7
from snap7.type import SrvArea

from hilserver.config.peers import PeerConfig
from hilserver.core.clock import UtcClock
from hilserver.core.events import EventBus
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.io.s7.peer import S7Peer
from tests.io.opcua_client.conftest import RecordingGate
from tests.loopback.rig import configuration

SIDES = ("fl", "rl", "fr", "rr")
DRIVE = [
    {"signal": "wheel.fl.setpoint_rpm", "at": 0},
    {"signal": "wheel.rl.setpoint_rpm", "at": 4},
    {"signal": "sim.tick", "at": 8, "type": "DINT"},
    {"signal": "wheel.fl.speed_rpm", "at": 16, "type": "LREAL"},
    {"signal": "drive.enable", "at": 24.1, "type": "BOOL"},
]


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


@asynccontextmanager
async def daemon_with(blocks, **server):
    section = {"server": {"port": 0, "blocks": blocks, **server}}
    config = configuration(
        s7=section, opcua={"enabled": False}, page={"enabled": False}
    )
    async with Daemon(assemble_config(config)) as daemon:
        yield daemon, int(daemon.part("s7").address.rpartition(":")[2])


class Controller:
    """Two blocks of a foreign server: 1 is read by the peer, 2 is written by it.

    In block 1: counter at byte 0, two set-points from 4 on, counter at `end`.
    """

    def __init__(self, port, size):
        self.coming, self.going = bytearray(size), bytearray(size)
        self.end = size - 4
        self.server = snap7.server.Server()
        for number, block in ((1, self.coming), (2, self.going)):
            self.server.register_area(SrvArea.DB, number, block)
        self.server.start(tcp_port=port)

    def offer(self, first, last, left, right):
        """Put counters and set-points where the peer reads them."""
        block = bytearray(self.coming)
        struct.pack_into(">Iff", block, 0, first, left, right)
        struct.pack_into(">I", block, self.end, last)
        self.coming[:] = block


@contextmanager
def controller(port, size=16):
    running = Controller(port, size)
    try:
        yield running
    finally:
        running.server.stop()
        running.server.destroy()


class Link:
    """A peer and all that came of it."""

    def __init__(self, port, size=16, **changes):
        section = {
            "name": "iot2050",
            "endpoint": f"s7://127.0.0.1:{port}/0/1",
            "poll_ms": 5,
            "write_every_ms": 5,
            "stale_after_ms": 200,
            "heartbeat": {
                "read": ["DB1,UDINT0", f"DB1,UDINT{size - 4}"],
                "write": ["DB2,UDINT0", f"DB2,UDINT{size - 4}"],
            },
            "read": {
                "DB1,REAL4": "wheel.fl.setpoint_rpm",
                "DB1,REAL8": "wheel.fr.setpoint_rpm",
            },
            "write": {
                "wheel.fl.speed_rpm": "DB2,REAL4",
                "wheel.fr.speed_rpm": "DB2,REAL8",
            },
        } | changes
        self.gate, self.events, self.outputs = RecordingGate(), EventBus(), {}
        self.peer = S7Peer(
            PeerConfig.model_validate(section),
            assemble_config(configuration()).table,
            gate=self.gate,
            events=self.events,
            read_output=lambda name: (self.outputs.get(name, 0.0), 0, 0),
            clock=UtcClock(),
        )
        self.status = self.peer.status

    async def __aenter__(self):
        await self.peer.start()
        return self

    async def __aexit__(self, *error):
        await self.peer.stop()

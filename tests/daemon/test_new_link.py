"""A newcomer's link: set-points over UDP, as `docs/how-to/extend.md` says.

Three places: this file stands for its folder and for its section, `links` for its line in `LINKS`.
Lease, safe state, banner, metrics and OPC UA figures follow from them.
"""

import asyncio
import contextlib
import errno
import json
import socket
import time

import pytest
from pydantic import Field

from hilserver.commands.announcing import Announcer
from hilserver.commands.check import describe
from hilserver.config.root import Config
from hilserver.config.section import Driver, LinkSection
from hilserver.core.events import EventKind
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.connections import LINKS
from hilserver.daemon.daemon import Daemon
from hilserver.errors import FailedError
from hilserver.io.arrival import WATCH_S
from hilserver.io.link_status import PeerStatus
from hilserver.io.source import Source
from hilserver.io.world import Part
from hilserver.signals import State
from tests.loopback.rig import configuration, scrape, wait_until

LIMIT_MS = 2000.0


class UdpConfig(LinkSection):
    enabled: bool = False
    port: int = 0
    stale_after_ms: float = LIMIT_MS
    on_stale: str = "ramp"

    @property
    def driver(self):
        who = ("udp", "peer:udp", "the UDP sender")
        return Driver(
            *who, self.stale_after_ms, self.on_stale, self.enabled, has_faults=False
        )


class UdpConfiguration(Config):
    udp: UdpConfig = Field(default_factory=UdpConfig)


class UdpLink(Part, asyncio.DatagramProtocol):
    section = label = "udp"

    def __init__(self, world):
        config = world.config.udp
        self.status = PeerStatus("udp", f"port {config.port}")
        self._port, publish, self._job = config.port, world.events.publish, None
        self._tasks = world.tasks
        fresh = lambda: "UDP: datagrams come in"  # noqa: E731
        self._source = Source(
            config.driver, "UDP", self.status, world.gate, publish, fresh=fresh
        )

    @property
    def address(self):
        host, port = self._transport.get_extra_info("sockname")
        return f"udp://{host}:{port}"

    async def start(self):
        make = asyncio.get_running_loop().create_datagram_endpoint
        self._transport, _ = await make(
            lambda: self, local_addr=("127.0.0.1", self._port)
        )
        self._job = self._tasks.every("udp: watch", WATCH_S, self._look)

    async def stop(self):
        if self._job is not None:
            self._job.cancel()
            self._transport.close()

    def _look(self):
        self._source.watch(time.monotonic_ns())
        self.status.connected = not self.status.stale

    def datagram_received(self, data, _address):
        now_ns = time.monotonic_ns()
        with contextlib.suppress(ValueError):
            values = dict(json.loads(data))
            if not self._source.write(values, now_ns).wrong:
                self._source.staleness.renew(now_ns)


def parts(world):
    if world.config.udp.enabled:
        yield UdpLink(world)


class Notes:
    """A terminal that keeps what is said."""

    def __init__(self):
        self.text = ""
        self.write = self._keep
        self.is_watched = True

    def isatty(self):
        return False

    def _keep(self, text):
        self.text += text


async def test_a_link_of_its_own_drives_is_shown_and_lapses():
    base = configuration(opcua={"enabled": False})
    config = UdpConfiguration.model_validate(
        base.model_dump() | {"udp": {"enabled": True}}
    )
    async with Daemon(assemble_config(config), links=(*LINKS, parts)) as daemon:
        link, notes = daemon.part("udp"), Notes()
        Announcer(notes, "console").running(daemon)
        assert f"  udp      {link.address}" in notes.text
        port = int(link.address.rpartition(":")[2])
        speed = daemon.table.slot("wheel.fl.speed_rpm")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:

            def drives():
                for values in (
                    {"wheel.fl.setpoint_rpm": 30.0},
                    {"wheel.fl.setpoint_rpm": "fast"},
                ):
                    sender.sendto(json.dumps(values).encode(), ("127.0.0.1", port))
                sender.sendto(b"no JSON", ("127.0.0.1", port))
                return daemon.image.frame_values[speed] > 20.0 and link.status.connected

            await wait_until(drives)
        assert +link.status.fault_counts == {
            "refused_value": link.status.fault_counts.total()
        }
        text = await scrape(daemon)
        assert 'hil_peer_faults_total{kind="refused_value",peer="udp"}' in text
        assert 'hil_input_age_seconds{source="peer:udp"}' in text
        await wait_until(
            lambda: daemon.control.state is State.SAFE and link.status.stale
        )
        assert daemon.control.reason == "the UDP sender is silent"
        lost = [
            e.message for e in daemon.events.recent if e.kind is EventKind.PEER_LOST
        ]
        assert lost == [
            f"UDP: no new value for more than {LIMIT_MS:g} ms; on_stale is ramp"
        ]


async def test_a_port_in_use_is_one_sentence_with_a_remedy():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        base = configuration(opcua={"enabled": False}).model_dump()
        section = {"enabled": True, "port": taken.getsockname()[1]}
        config = UdpConfiguration.model_validate(base | {"udp": section})
        with pytest.raises(
            FailedError, match=r"^udp: cannot start \(.*in use\); end the program"
        ):
            async with Daemon(assemble_config(config), links=(*LINKS, parts)):
                pass


@pytest.mark.parametrize(
    "error",
    [
        PermissionError(errno.EACCES, "Permission denied", "udp.key"),
        OSError(errno.ENODEV, "No such device"),
    ],
)
async def test_what_is_no_matter_of_an_address_is_not_called_one(monkeypatch, error):
    async def start(_link):
        raise error

    monkeypatch.setattr(UdpLink, "start", start)
    base = configuration(opcua={"enabled": False}).model_dump()
    config = UdpConfiguration.model_validate(base | {"udp": {"enabled": True}})
    with pytest.raises(OSError, match=error.strerror) as caught:
        async with Daemon(assemble_config(config), links=(*LINKS, parts)):
            pass
    assert caught.value is error


def test_the_check_of_a_configuration_names_it():
    assembly = assemble_config(UdpConfiguration(udp=UdpConfig(enabled=True)))
    lines = describe(assembly)
    assert "link udp: on, stale after 2000 ms: ramp" in lines
    assert any(
        line.startswith("control: 'peer' has control at the start") for line in lines
    )
    assert not any(line.startswith("warning") for line in lines)

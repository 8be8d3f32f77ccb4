"""A daemon with its controller, in one process and one event loop, on a network in memory."""

import asyncio
import contextlib
import fcntl
import mmap
import os
import random
from collections import deque
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, ClassVar

import structlog

import hilserver.image.process_image
import hilserver.image.reader
import hilserver.opcua.transport
import hilserver.scheduler.scheduler
from hilserver.config.root import Config
from hilserver.controller.server import ControllerServer
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.image import ImageReader
from hilserver.image.shared_file import path_of
from tests.control.robot import PEER_NODES, WHEELS
from tests.hours.clock import CLOCK, install_dates
from tests.hours.loop import VirtualLoop
from tests.hours.network import MemoryTransport, Network
from tests.hours.pacing import ClockPacing

OPCUA_PORT, PEER_PORT, S7_PORT = 4840, 53880, 10102
S7_CLIENTS = 8
RING_FRAMES = 1 << 13
PUBLISH_MS = 50.0
SAFE_RAMP_S = 0.1
PEER_LEASE_MS, HAND_LEASE_MS, OPCUA_LEASE_MS = 500.0, 300.0, 1500.0
STANDSTILL_MS = 1000.0
MOST_LINES = 2000
MOST_TASKS, MOST_NAMES = 200, 300
MOST_UNSENT_BYTES = 2 * 256 * 1024


def configuration(mode: str) -> dict[str, Any]:
    """Return a robot with a controller, for users of every kind."""
    nodes = {
        f"rpm_set_{wheel.upper()}": f"wheel.{wheel}.setpoint_rpm" for wheel in WHEELS
    }
    nodes["enable"] = "drive.enable"
    return {
        # Always as long, as it is part of what clients read.
        "image": {"name": f"hours-{os.getpid():07}", "ring_frames": RING_FRAMES},
        "plant": {"safe_ramp_s": SAFE_RAMP_S},
        "control": {"source": "peer", "opcua_stale_after_ms": OPCUA_LEASE_MS},
        "opcua": {
            "endpoint": f"opc.tcp://127.0.0.1:{OPCUA_PORT}/h",
            "max_connections": 40,
            "max_sessions": 20,
        },
        "metrics": {"port": 9464},
        "s7": {
            "server": {
                "port": S7_PORT,
                "max_clients": S7_CLIENTS,
                "blocks": {
                    1: [
                        {"signal": "sim.tick", "at": 0, "type": "DINT"},
                        {"signal": "measured.pose.x_m", "at": 4},
                    ]
                },
            }
        },
        "page": {"deadman_ms": HAND_LEASE_MS},
        "peers": [
            {
                "name": "plc",
                "endpoint": f"opc.tcp://127.0.0.1:{PEER_PORT}/UA/NodeRedAgv",
                "mode": mode,
                "poll_ms": 50,
                "publishing_ms": 50,
                "stale_after_ms": PEER_LEASE_MS,
                "sequence_node": f"{PEER_NODES}seq",
                "read": {f"{PEER_NODES}{node}": name for node, name in nodes.items()},
            }
        ],
        "scheduler": {
            "slices": {"publish": PUBLISH_MS, "supervise": 100.0},
            "limits": {"single_overrun_ms": None, "consecutive_overruns": None},
            "communication_timeout_ms": STANDSTILL_MS,
            "realtime": {
                "lock_memory": False,
                "priority": 0,
                "hold_latency_target": False,
            },
        },
    }


def stood_ns(times: list[tuple[int, int]], begin_ns: int, end_ns: int) -> int:
    """Return how much of the time between begin and end these times cover, each by itself."""
    return sum(max(min(b, end_ns) - max(a, begin_ns), 0) for a, b in times)


class PrivateFile:
    """Memory of this process in place of a shared file: a fork has its own."""

    made: ClassVar[dict[str, mmap.mmap]] = {}

    def __init__(self, name: str, n_bytes: int) -> None:
        flags = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS
        self.map = self.made[name] = mmap.mmap(-1, n_bytes, flags=flags)
        self.path = path_of(name)  # locked and empty: it says that a daemon is there
        self._fd = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o600)
        fcntl.flock(self._fd, fcntl.LOCK_EX)

    def close(self) -> None:
        self.path.unlink(missing_ok=True)
        os.close(self._fd)
        with contextlib.suppress(BufferError):
            self.map.close()


class Town:
    """The robot and everything around it."""

    def __init__(self, folder: Path, mode: str = "poll") -> None:
        self.loop = VirtualLoop(CLOCK)
        self.network = Network(self.loop)
        self.network.heard = self._heard
        # called with the name of whom the daemon hears
        self.on_heard: Callable[[str], None] = lambda _user: None
        self.lines: deque[tuple[float, dict[str, Any]]] = deque(maxlen=MOST_LINES)
        self.stalls: list[tuple[int, int]] = []  # when nothing ran in the loop
        self.holds: list[tuple[int, int]] = []  # when nothing arrived
        self.is_recorded = False
        self.seed = 0
        self.stood_ns = 0  # when the plant was last seen paused
        self._inject()
        settings = configuration(mode)
        self.image = settings["image"]["name"]
        config = Config.model_validate(settings)
        self.assembly = assemble_config(config, folder)
        self.folder = folder

    def _inject(self) -> None:
        """Put the virtual parts where the product would use those of the computer."""
        hilserver.scheduler.scheduler.ThreadPacing = ClockPacing
        hilserver.image.process_image.SharedFile = PrivateFile
        hilserver.image.reader.map_read_only = PrivateFile.made.__getitem__
        # it would look for our connections among those of the computer
        hilserver.opcua.transport.is_own_program = lambda *_: False
        structlog.configure(
            processors=[self._log], logger_factory=structlog.ReturnLoggerFactory()
        )
        install_dates()

    def _log(self, _logger: Any, level: str, entry: dict[str, Any]) -> str:
        self.lines.append((CLOCK.now_ns * 1e-9, {"level": level, **entry}))
        return ""

    def _heard(self, at: MemoryTransport) -> None:
        if at.names[0][1] == OPCUA_PORT:
            self.on_heard(at.other.label)
        elif at.names[1][1] == PEER_PORT:
            self.on_heard("peer")

    def chance_of(self, who: str) -> random.Random:
        """Return a chance of its own: whoever is left out changes nothing of what others draw."""
        return random.Random(f"{self.seed} {who}")

    def stand_still(self, seconds: float) -> None:
        """Hold up the event loop."""
        now_ns = CLOCK.now_ns
        self.loop.stand_still(seconds)
        self.stalls.append((now_ns, CLOCK.now_ns))

    def hold(self, seconds: float) -> None:
        """Let nothing arrive for a while."""
        self.network.hold(seconds)
        self.holds.append((CLOCK.now_ns, self.network.held_until_ns))

    def disturbed_ns(self, begin_ns: int, end_ns: int) -> int:
        """Return for how long loop or network stood still in this time."""
        return stood_ns(self.stalls + self.holds, begin_ns, end_ns)

    def has_stood(self, since_ns: int) -> bool:
        """Whether the plant was paused since then."""
        return self.stood_ns >= since_ns

    def frame(self, name: str) -> float:
        """Return the newest value of a signal."""
        return float(self.reader.latest().values[self.slots[name]])

    def limited(self) -> dict[str, tuple[int, int]]:
        """Return the length of every queue, and its limit."""
        daemon = self.daemon
        listener, server = (
            getattr(daemon.part("opcua")._server, n) for n in ("bserver", "iserver")
        )
        settings = daemon.config.opcua
        subscriptions = server.subscription_service.subscriptions
        return {
            "tasks": (len(asyncio.all_tasks()), MOST_TASKS),
            "connections": (len(listener.clients), settings.max_connections),
            "sessions": (len(server.sessions), settings.max_sessions),
            "S7 clients": (len(daemon.part("s7")._server._places), S7_CLIENTS),
            "subscriptions": (len(subscriptions), settings.max_subscriptions),
            "unsent bytes": (
                self.network.most_unsent.get(OPCUA_PORT, 0),
                MOST_UNSENT_BYTES,
            ),
            "refused values by name": (len(daemon.gate.rejected), MOST_NAMES),
        }

    def not_good(self) -> list[str]:
        """Return what is not as it has to be when nothing is wrong."""
        daemon = self.daemon
        links = [link for link in daemon._statuses() if link.name != "s7"]
        found = [
            f"peer {link.name} is not connected: {link.last_error}"
            for link in links
            if not link.connected
        ]
        found += [f"peer {link.name} is stale" for link in links if link.stale]
        if why := daemon.core.tasks.why_down():
            found.append(why)
        running = {job.name for job in daemon.core.tasks.jobs if job.lasting}
        found += [f"task '{name}' is gone" for name in sorted(self.lasting - running)]
        return found

    async def start(self) -> None:
        """Start the controller and the daemon."""
        self.controller = ControllerServer(
            f"opc.tcp://127.0.0.1:{PEER_PORT}/UA/NodeRedAgv"
        )
        await self.controller.__aenter__()
        self.network.listening[PEER_PORT].label = "controller"
        self.daemon = Daemon(self.assembly)
        await self.daemon.__aenter__()
        install_dates()
        self.lasting = {job.name for job in self.daemon.core.tasks.jobs if job.lasting}
        self.reader = ImageReader.attach(self.image)
        self.slots = {
            s["name"]: s["slots"][0] for s in self.reader.description["signals"]
        }
        self.types = {s["name"]: s["type"] for s in self.reader.description["signals"]}

    async def stop(self) -> None:
        await self.daemon.__aexit__()
        await self.controller.__aexit__()

    # --- its controller ---------------------------------------------------------------------------

    peer_lease_ms = PEER_LEASE_MS

    async def offer(self, rpm: float, sequence: int) -> None:
        """Let the controller offer a speed."""
        signs = {"FL": 1, "RL": 1, "FR": -1, "RR": -1}
        speeds = {f"rpm_set_{wheel}": sign * rpm for wheel, sign in signs.items()}
        await self.controller.offer(
            speeds | {"enable": True, "seq": sequence}, datetime.now(UTC)
        )

    @contextlib.contextmanager
    def peer_refuses(self) -> Iterator[None]:
        """Let nobody listen at the controller."""
        server = self.network.listening.pop(PEER_PORT)
        try:
            yield
        finally:
            self.network.listening[PEER_PORT] = server

    @contextlib.contextmanager
    def peer_swallows(self) -> Iterator[None]:
        """Let the controller's computer not answer at all."""
        self.network.swallows.add(PEER_PORT)
        try:
            yield
        finally:
            self.network.swallows.discard(PEER_PORT)

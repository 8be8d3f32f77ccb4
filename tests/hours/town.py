"""A daemon with its controller, in one process and one event loop, on a network in memory."""

import contextlib
import mmap
from collections import deque
from pathlib import Path
from typing import Any

import structlog

import hilserver.image.process_image
import hilserver.image.reader
import hilserver.scheduler.scheduler
from hilserver.config.root import Config
from hilserver.controller.server import ControllerServer
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.image import ImageReader
from tests.control.robot import PEER_NODES, WHEELS
from tests.hours.clock import CLOCK, install_dates
from tests.hours.loop import VirtualLoop
from tests.hours.network import MemoryTransport, Network
from tests.hours.pacing import ClockPacing

OPCUA_PORT, PEER_PORT = 4840, 53880
RING_FRAMES = 1 << 12
SAFE_RAMP_S = 0.1
PEER_LEASE_MS, HAND_LEASE_MS, OPCUA_LEASE_MS = 500.0, 300.0, 1500.0
STANDSTILL_MS = 1000.0
MOST_LINES = 2000


def configuration(mode: str) -> dict[str, Any]:
    """Return a robot with a controller, for users of every kind."""
    nodes = {f"rpm_set_{wheel.upper()}": f"wheel.{wheel}.setpoint_rpm" for wheel in WHEELS}
    nodes["enable"] = "drive.enable"
    return {
        "image": {"name": "hours", "ring_frames": RING_FRAMES},
        "plant": {"safe_ramp_s": SAFE_RAMP_S},
        "control": {"source": "peer", "opcua_stale_after_ms": OPCUA_LEASE_MS},
        "opcua": {"endpoint": f"opc.tcp://127.0.0.1:{OPCUA_PORT}/h"},
        "metrics": {"port": 9464},
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
            "slices": {"publish": 50.0, "supervise": 100.0},
            "limits": {"single_overrun_ms": None, "consecutive_overruns": None},
            "communication_timeout_ms": STANDSTILL_MS,
            "realtime": {"lock_memory": False, "priority": 0, "hold_latency_target": False},
        },
    }


class PrivateFile:
    """Memory of this process in place of a shared file: a fork has its own."""

    made: dict[str, mmap.mmap] = {}

    def __init__(self, name: str, n_bytes: int) -> None:
        flags = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS
        self.map = self.made[name] = mmap.mmap(-1, n_bytes, flags=flags)

    def close(self) -> None:
        with contextlib.suppress(BufferError):
            self.map.close()


class Town:
    """The robot and everything around it."""

    def __init__(self, folder: Path, mode: str = "poll") -> None:
        self.loop = VirtualLoop(CLOCK)
        self.network = Network(self.loop)
        self.network.heard = self._heard
        self.heard_ns: dict[str, int] = {}  # when the daemon last heard of a user
        self.lines: deque[tuple[float, dict[str, Any]]] = deque(maxlen=MOST_LINES)
        self._inject()
        config = Config.model_validate(configuration(mode))
        self.assembly = assemble_config(config, folder)
        self.folder = folder

    def _inject(self) -> None:
        """Put the virtual parts where the product would use those of the computer."""
        hilserver.scheduler.scheduler.ThreadPacing = ClockPacing
        hilserver.image.process_image.SharedFile = PrivateFile
        hilserver.image.reader.map_read_only = PrivateFile.made.__getitem__
        structlog.configure(
            processors=[self._log], logger_factory=structlog.ReturnLoggerFactory()
        )
        install_dates()

    def _log(self, _logger: Any, level: str, entry: dict[str, Any]) -> str:
        self.lines.append((CLOCK.now_ns * 1e-9, {"level": level, **entry}))
        return ""

    def _heard(self, at: MemoryTransport) -> None:
        if OPCUA_PORT == at.names[0][1]:
            self.heard_ns[at.other.label] = CLOCK.now_ns
        elif PEER_PORT == at.names[1][1]:
            self.heard_ns["peer"] = CLOCK.now_ns

    async def start(self) -> None:
        """Start the controller and the daemon."""
        self.controller = ControllerServer(f"opc.tcp://127.0.0.1:{PEER_PORT}/UA/NodeRedAgv")
        await self.controller.__aenter__()
        self.daemon = Daemon(self.assembly)
        await self.daemon.__aenter__()
        install_dates()
        self.reader = ImageReader.attach("hours")

    async def stop(self) -> None:
        await self.daemon.__aexit__()
        await self.controller.__aexit__()

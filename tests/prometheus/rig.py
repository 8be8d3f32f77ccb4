"""A daemon in this process with Node-RED as its peer, scraped by a real Prometheus."""

import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path

from hilserver.config.root import Config
from hilserver.controller.nodes import demo_peer
from hilserver.daemon.assembly import Assembly, assemble_config
from hilserver.daemon.connections import LINKS
from hilserver.daemon.daemon import Daemon
from hilserver.recalibration import link as recalibration
from tests.helpers.daemons import free_port
from tests.node_red.node_red import NodeRed
from tests.prometheus.server import Prometheus, running_prometheus, until

HERE = Path(__file__).parent
NO_SUCH_CORE = 4095
STALE_MS = 3000.0
"""A busy computer holds up daemon and controller for longer than half a second."""


@dataclass
class Rig:
    daemon: Daemon
    peer: NodeRed
    prometheus: Prometheus
    port: int
    blocks: bool
    line: Path

    def assembly(self, **realtime: object) -> Assembly:
        return assembly(
            self.peer.endpoint, self.port, self.line, blocks=self.blocks, **realtime
        )

    @property
    def is_connected(self) -> bool:
        return self.daemon.parts_of("peers")[0].status.connected

    @property
    def is_fresh(self) -> bool:
        return self.is_connected and not self.daemon.parts_of("peers")[0].status.stale


def assembly(
    endpoint: str, port: int, line: Path, *, blocks: bool, **realtime: object
) -> Assembly:
    burn = {
        "name": "burn",
        "function": "burn.py:burn",
        "slice": "plant",
        "inputs": {"red": "lights.red"},
    }
    config = Config.model_validate(
        {
            "image": {"name": "auto"},
            "opcua": {"enabled": False},
            "metrics": {"port": port},
            "scheduler": {
                "policy": "skip",
                "communication_timeout_ms": 0,
                "limits": {"single_overrun_ms": None, "consecutive_overruns": None},
                "realtime": realtime,
            },
            "peers": [
                demo_peer(endpoint, name="iot2050").model_dump(mode="json")
                | {"stale_after_ms": STALE_MS}
            ],
            "blocks": [burn] if blocks else [],
            "shield": {
                "enabled": blocks,
                "link": str(line),
            },  # a line without a host counts as lost
            "control": {"source": "peer"},
            "recalibration": {
                "enabled": blocks,
                "folder": str(line.parent / "recalibration"),
            },
            "sensors": {"nav": {"enabled": blocks}},
            "observer": {"enabled": blocks},
            "shadow": {"limits": {"wheel.fl.speed_rpm": 120.0}, "after_s": 0.0},
        }
    )
    return assemble_config(config, HERE)


@contextlib.asynccontextmanager
async def running_rig(
    peer: NodeRed, folder: Path, *, blocks: bool = False
) -> AsyncIterator[Rig]:
    port = free_port()
    await peer.start()
    line = folder / "shield"
    built = assembly(peer.endpoint, port, line, blocks=blocks)
    with running_prometheus(folder, f"127.0.0.1:{port}") as prometheus:
        async with Daemon(built, links=(*LINKS, recalibration.parts)) as daemon:
            rig = Rig(daemon, peer, prometheus, port, blocks, line)
            await until(lambda: rig.is_fresh, 120, "the peer delivers")
            await until(prometheus.target_is_up, 120, "Prometheus scrapes the daemon")
            yield rig

"""Commissioning against the shipped flow: the commands of its ROS 2 side turn wheel after wheel."""

import asyncio
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from hilserver.commands.wiring import WheelCheck, as_table
from hilserver.config.root import Config
from hilserver.controller.nodes import demo_peer
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.plant.layout import WHEEL_WORDS
from tests.node_red.node_red import shipped_flow

pytestmark = pytest.mark.node_red

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
SPEED_RPM = 20.0
PAUSE_S = 0.7
TAB = "tab-test-commands"


def with_commands(flow: list[dict], source: Path) -> list[dict]:
    """Return the shipped flow with the RotationSpeed in a file as commands from ROS 2, 20 Hz."""
    flow = json.loads(json.dumps(flow))
    for node in flow:
        if node["id"] == "commands-in":
            node["links"] = ["commands-out"]
    ours = {"z": TAB, "wires": [["commands-file"]]}
    return [
        *flow,
        {"id": TAB, "type": "tab", "label": "what the operator commands"},
        ours
        | {"id": "commands-timer", "type": "inject", "props": [], "repeat": "0.05", "once": True},
        ours
        | {
            "id": "commands-file",
            "type": "file in",
            "filename": str(source),
            "filenameType": "str",
            "format": "utf8",
            "wires": [["commands-parse"]],
        },
        ours | {"id": "commands-parse", "type": "json", "action": "obj", "property": "payload",
                "wires": [["commands-out"]]},
        ours | {"id": "commands-out", "type": "link out", "mode": "link",
                "links": ["commands-in"], "wires": []},
    ]  # fmt: skip


class Operator:
    """Turns the wheel that `hilserver wiring` asks for, with the drive's mirrored right side."""

    def __init__(
        self, path: Path, wheel_of: Callable[[str], str] = lambda wheel: wheel
    ) -> None:
        self._path = path
        self._wheel_of = wheel_of
        self._task: asyncio.Task[None] | None = None
        self.turn(None)

    def turn(self, wheel: str | None) -> None:
        speeds = {f"{name}_rpm": 0.0 for name in WHEELS}
        if wheel is not None:
            speeds[f"{wheel}_rpm"] = SPEED_RPM if wheel.endswith("left") else -SPEED_RPM
        temporary = self._path.with_suffix(".new")
        temporary.write_text(json.dumps(speeds), encoding="utf-8")
        temporary.replace(self._path)

    def told(self, text: str) -> None:
        (wheel,) = (
            name.replace(" ", "_")
            for name in WHEEL_WORDS.values()
            if f"the {name} " in text
        )
        self._task = asyncio.create_task(self._obey(self._wheel_of(wheel)))

    async def _obey(self, wheel: str) -> None:
        self.turn(None)
        await asyncio.sleep(PAUSE_S)
        self.turn(wheel)


async def wired(node_red, operator: Operator, source: Path) -> list:
    # A command that comes late is none, instead of the flow's own demonstration.
    environment = {"IOTBOT_DEMO": "0"}
    flow = with_commands(shipped_flow(), source)
    instance = await node_red(flow, environment=environment).start()
    peer = demo_peer(instance.endpoint)
    config = Config.model_validate(
        {
            "image": {"name": "auto"},
            "opcua": {"enabled": False},
            "metrics": {"enabled": False},
            "scheduler": {
                "limits": {"single_overrun_ms": None, "consecutive_overruns": None}
            },
            "peers": [peer.model_dump(mode="json") | {"stale_after_ms": 400.0}],
        }
    )
    async with Daemon(assemble_config(config)) as daemon:
        return await WheelCheck(
            daemon, peer.name, SPEED_RPM, 20.0, operator.told
        ).check()


async def test_the_shipped_flow_is_wired_as_it_should_be(node_red, tmp_path):
    source = tmp_path / "command.json"
    findings = await wired(node_red, Operator(source), source)
    assert [f.what for f in findings] == ["fl", "rl", "fr", "rr", "stale"]
    assert [f.complaint for f in findings] == [""] * 5, as_table(findings)


async def test_cables_that_were_swapped_at_the_controller_are_named(node_red, tmp_path):
    source = tmp_path / "command.json"
    swapped = {"front_left": "front_right", "front_right": "front_left"}
    operator = Operator(source, lambda wheel: swapped.get(wheel, wheel))
    findings = await wired(node_red, operator, source)
    assert [f.complaint for f in findings] == [
        "side: front right instead of front left",
        "",
        "side: front left instead of front right",
        "",
        "",
    ], as_table(findings)

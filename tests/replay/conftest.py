"""One real run, recorded from its first tick and once more from its middle, with a snapshot."""

import asyncio
import math
import signal
from dataclasses import dataclass
from pathlib import Path

import pytest
from asyncua import ua

from hilserver.commands import main
from tests.helpers.daemons import (
    RunningDaemon,
    finish,
    running_daemon,
    start_recorder,
    wait_for_start,
)
from tests.io.opcua_server.rig import RobotClient

CONFIG = """
sensors: {nav: {enabled: true}}
plant: {seed: 5}
control: {command_timeout_ms: 300}
"""


@pytest.fixture
def replay_here(tmp_path, monkeypatch, capsys):
    """`hilserver replay` in this process, in a folder of its own; returns what it says."""
    monkeypatch.chdir(tmp_path)

    def run(*words, code=0):
        found = main(["replay", *map(str, words)])
        said = capsys.readouterr()
        assert found == code, said
        return said.out + said.err

    return run


@dataclass
class Recorded:
    folder: Path
    full: Path
    middle: Path
    snapshot: Path


@pytest.fixture(scope="session")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded")
    with running_daemon(folder, "--record", "full.mcap", config=CONFIG) as daemon:
        asyncio.run(drive(daemon))
        assert daemon.stop() == 0
    return Recorded(
        folder,
        folder / "full.mcap",
        folder / "middle.csv",
        folder / "snapshots" / "middle.npz",
    )


async def drive(daemon: RunningDaemon) -> None:
    """Use all that acts on the plant: set-points, lapse, handover, pose, pause, stop, reset."""
    client = RobotClient(daemon.url)
    await client.connect()
    try:
        await wander(client, 0.6)
        await client.call("SetPose", *(ua.Variant(v) for v in (1.0, -2.0, 0.5)))
        middle = await asyncio.to_thread(
            start_recorder, daemon, daemon.folder / "middle.csv"
        )
        await asyncio.to_thread(wait_for_start, middle)
        await wander(client, 1.0)
        for command in ("Pause", "Start"):
            assert (await client.call(command)).StatusCode.is_good()
            await asyncio.sleep(0.2)
        name = ua.Variant("middle", ua.VariantType.String)
        assert (await client.call("SaveSnapshot", name)).StatusCode.is_good()
        await wander(client, 1.0)
        middle.send_signal(signal.SIGTERM)
        code, text = await asyncio.to_thread(finish, middle)
        assert (code, "none lost" in text) == (0, True)
        await asyncio.sleep(0.4)  # the command lapses
        for source in ("peer", "opcua"):  # handed over while it drives, and back
            await wander(client, 0.2)
            await client.write(("control.source", source, ua.VariantType.String))
        await wander(client, 0.2)
        assert (await client.call("Stop")).StatusCode.is_good()
        await asyncio.sleep(0.8)
        # acknowledges the safe state
        assert (await client.call("Reset")).StatusCode.is_good()
        await wander(client, 0.2)  # it waits for Start
        assert (await client.call("Start")).StatusCode.is_good()
        await wander(client, 0.4)
        assert (await client.call("Reset")).StatusCode.is_good()  # back to tick 0
        await wander(client, 0.6)
    finally:
        await client.disconnect()


async def wander(client: RobotClient, seconds: float) -> None:
    for i in range(round(seconds / 0.02)):
        left, right = 60 * math.sin(0.3 * i), 40 * math.cos(0.17 * i)
        await client.write_doubles(
            wheel__fl__setpoint_rpm=left,
            wheel__rl__setpoint_rpm=left,
            wheel__fr__setpoint_rpm=-right,
            wheel__rr__setpoint_rpm=-right,
        )
        await asyncio.sleep(0.02)

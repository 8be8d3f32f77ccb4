"""node-opcua, a client of another make, drives the robot (packages of tests/foreign_client)."""

import asyncio
import json
import shutil
from pathlib import Path

import pytest

from hilserver import __version__
from hilserver.signals import State
from tests.io.opcua_server.rig import Rig

FOLDER = Path(__file__).parents[1] / "foreign_client"

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.node_red]


async def tick_for_ever(rig: Rig) -> None:
    while True:
        rig.tick()
        await asyncio.sleep(0.02)


async def test_node_opcua_reads_takes_control_writes_subscribes_and_calls(
    rig: Rig,
) -> None:
    node = shutil.which("node")
    assert node, "Node.js 20 is needed (make test installs its packages)"
    assert (FOLDER / "node_modules" / "node-opcua-client").is_dir(), (
        "run: npm install --prefix tests/foreign_client"
    )
    rig.control.started()
    rig.set("pose.x_m", 0.75)
    plant = asyncio.create_task(tick_for_ever(rig))
    process = await asyncio.create_subprocess_exec(
        node, "drive.cjs", rig.server.url, "25", cwd=FOLDER,
        stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    try:
        out, err = await asyncio.wait_for(process.communicate(), 200)
    finally:
        plant.cancel()
        if process.returncode is None:
            process.kill()
    assert process.returncode == 0, err.decode()
    found = json.loads(out.decode().strip().splitlines()[-1])
    assert found["browsed"] == "ns=2;s=pose.x_m"
    assert found["range"] == [-90, 90]
    assert found["pose"] == {"value": 0.75, "status": "Good", "stamped": True}
    maker, model, serial, version = found["nameplate"]
    assert (maker, model) == ("hilserver", "Simulated four-wheeled robot")
    assert (len(serial), version) == (12, __version__)
    assert found["before_control"] == "BadUserAccessDenied"
    assert found["take_control"] == "Good"
    assert found["refused"] == [
        "BadOutOfRange",
        "BadOutOfRange",
        "BadTypeMismatch",
        "BadNotWritable",
    ]
    assert found["wrote"] == "Good"
    assert (found["speeds"][0], found["speeds"][-1]) == (0, 25)
    assert found["all_speeds"] == [25, 25, -25, -25]
    assert found["called"] == ["Good", "Good", "BadNotImplemented"]
    assert rig.control.state is State.PAUSED
    assert rig.gate.owner == "nobody", "it had taken control, and is gone"
    assert "step 3" in rig.pacing.calls

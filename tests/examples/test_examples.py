"""Every example does what its README says, started as a user starts it."""

import asyncio
import csv
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from asyncua import Client, ua

from hilserver.commands import main
from hilserver.daemon.assembly import assemble
from hilserver.sweep.estimates import influences
from hilserver.sweep.table import read_table
from tests.helpers.daemons import free_port
from tests.loopback.rig import configuration, running, wait_until
from tests.node_red.node_red import NodeRed, missing, with_sink

EXAMPLES = Path(__file__).parents[2] / "examples"
PATIENCE_S = 600.0


def started(script, *arguments, **environment):
    """Start an example's program; its output is a pipe."""
    command = [sys.executable, str(EXAMPLES / script), *arguments]
    environment = {**os.environ, **environment}
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)


def test_every_folder_is_listed():
    listed = re.findall(
        r"^\| \[[^]]+\]\(([^)]+)\)", (EXAMPLES / "README.md").read_text(), re.M
    )
    assert sorted(listed) == sorted(p.name for p in EXAMPLES.iterdir() if p.is_dir())


async def test_own_controller_drives_a_square_and_gives_control_back():
    # Where the computer holds the controller up, the robot waits for it.
    control = {"source": "peer", "command_timeout_ms": 200}
    async with running(configuration(control=control)) as (daemon, _):
        program = started("own-controller/drive_square.py", daemon.part("opcua").url)
        text, _ = await asyncio.to_thread(program.communicate, timeout=600)
        assert program.returncode == 0
        corners = re.findall(r"corner \d: x (\S+) m, y (\S+) m", text)
        xs, ys = np.array(corners, dtype=float).T
        assert len(corners) == 4
        assert np.hypot(xs[-1], ys[-1]) < 0.4
        assert max(xs) > 0.5
        assert daemon.gate.owner == "peer"


async def test_a_left_right_controller_moves_all_four_wheels():
    endpoint = f"opc.tcp://127.0.0.1:{free_port()}/controller"
    peers = assemble(EXAMPLES / "left-right-controller" / "config.yaml").config.peers
    peer = peers[0].model_copy(update={"endpoint": endpoint})
    program = started("left-right-controller/controller.py", endpoint)
    try:
        async with running(configuration(peers=[peer.model_dump()])) as (daemon, _):

            def speeds():
                names = (f"wheel.{w}.speed_rpm" for w in ("fl", "rl", "fr", "rr"))
                return [
                    daemon.image.frame_values[daemon.table.slot(name)] for name in names
                ]

            await wait_until(
                lambda: min(speeds()[:2]) > 15 and max(speeds()[2:]) < -15, PATIENCE_S
            )
            left_front, left_rear, right_front, right_rear = speeds()
            assert left_front == pytest.approx(left_rear, abs=1.0)
            assert right_front == pytest.approx(right_rear, abs=1.0)
    finally:
        program.kill()
        program.communicate()


async def test_a_hardened_server_of_ten_lines_lets_its_valve_be_opened():
    program = started(
        "opcua-server/server.py", "opc.tcp://127.0.0.1:0/tank", PYTHONUNBUFFERED="1"
    )
    try:
        url = (await asyncio.to_thread(program.stdout.readline)).strip()
        async with Client(url) as client:
            index = await client.get_namespace_index("urn:example:tank")
            level, valve = (
                client.get_node(ua.NodeId(n, index)) for n in ("level_m", "valve")
            )
            with pytest.raises(ua.uaerrors.BadNotWritable):
                await level.write_value(2.0)
            before = await level.read_value()
            await valve.write_value(1.0)
            async with asyncio.timeout(60):
                while await level.read_value() >= before:  # noqa: ASYNC110
                    await asyncio.sleep(0.05)
    finally:
        program.kill()
        program.communicate()


async def test_a_program_without_ros_drives_over_ros_2():
    pytest.importorskip("cyclonedds")
    from tests.io.ros2.rig import claimed_domain, robot  # noqa: PLC0415 -- an extra

    with claimed_domain() as domain:
        async with robot(domain):
            program = started("ros2-client/drive.py", ROS_DOMAIN_ID=str(domain))
            text, _ = await asyncio.to_thread(program.communicate, timeout=600)
    assert program.returncode == 0
    assert float(re.search(r"turned with (\S+) rpm", text)[1]) > 25.0


async def test_a_controller_in_lockstep_sees_the_same_bits_every_time():
    config = configuration(
        scheduler={"backend": "virtual"}, control={"source": "opcua"}
    )
    async with running(config) as (daemon, _):
        said = []
        for _ in range(2):
            program = started("lockstep/lockstep.py", daemon.part("opcua").url)
            text, _ = await asyncio.to_thread(program.communicate, timeout=600)
            assert program.returncode == 0
            said.append(re.search(r"heading (\S+) rad after (\S+) s", text).groups())
    assert said[0] == said[1]
    assert float(said[0][0]) == pytest.approx(1.0, abs=0.01)


def test_a_sweep_says_that_friction_decides(tmp_path, capsys):
    text = (EXAMPLES / "sweep" / "sweep.yaml").read_text()
    assert "machines: 300\n" in text
    shutil.copy(EXAMPLES / "sweep" / "controller.py", tmp_path)
    (tmp_path / "sweep.yaml").write_text(
        text.replace("machines: 300\n", "machines: 40\n")
    )
    out = tmp_path / "result"
    assert (
        main(["sweep", str(tmp_path / "sweep.yaml"), "-o", str(out), "--workers", "2"])
        == 0
    )
    assert "of 40 machines pass" in capsys.readouterr().out
    table = read_table(out)
    found = influences(dict(table.parameters), table.margins["arrives"])
    assert found[0].names == ("terms.coulomb_friction",)
    assert found[0].interval[1] < -0.8
    friction, margin = (
        table.parameters["terms.coulomb_friction"],
        table.margins["arrives"],
    )
    assert margin[friction > 13.0].max() < 0.0 < margin[friction < 6.0].min()


@pytest.mark.long
def test_a_campaign_of_variants_sums_up(tmp_path):
    program = started("variants/variants.py", str(tmp_path / "campaign"))
    program.communicate(timeout=600)
    assert program.returncode == 0
    with (tmp_path / "campaign" / "summary.csv").open() as file:
        lines = list(csv.DictReader(file))
    yaw = {float(line["terms.rotation_gain"]): float(line["yaw_rad"]) for line in lines}
    assert len(lines) == 6
    assert yaw[0.0] > yaw[-0.2] > yaw[-0.4] > 0.5


@pytest.mark.node_red
async def test_node_red_as_a_client_drives_a_circle(tmp_path):
    if sentence := missing():
        pytest.fail(sentence, pytrace=False)
    poses = tmp_path / "poses.jsonl"
    flow = json.loads((EXAMPLES / "node-red-client" / "flows.json").read_text())
    flow = with_sink(flow, poses, out="pose-out")
    async with running(configuration()) as (daemon, _):
        environment = {"HIL_ENDPOINT": daemon.part("opcua").url}
        node_red = NodeRed(
            tmp_path / "home", free_port(), flow, environment=environment
        )
        await node_red.start(ready=False)
        try:
            yaw = daemon.table.slot("velocity.angular_rad_s")
            await wait_until(lambda: daemon.image.frame_values[yaw] > 0.4, 60)
            await wait_until(
                lambda: poses.exists() and "pose.x_m" in poses.read_text(), PATIENCE_S
            )
        finally:
            await node_red.kill()


def test_the_own_block_fits_its_configuration(capsys):
    assert main(["check", "-c", str(EXAMPLES / "own-block" / "config.yaml")]) == 0
    assert "own block load_cell" in capsys.readouterr().out


def diagnosed(folder, log, out):
    """Return what `hilserver diagnose` finds in a log of an example."""
    words = [
        "-c",
        str(folder / "config.yaml"),
        "--mapping",
        str(folder / "mapping.yaml"),
    ]
    assert main(["diagnose", str(log), *words, "--out", str(out)]) == 0
    findings = json.loads((out / "findings.json").read_text())["findings"]
    return [(tuple(f["causes"]), f["parameters"]) for f in findings]


def test_foreign_csv_and_bag_tell_the_same(tmp_path):
    table, bag = EXAMPLES / "foreign-csv", EXAMPLES / "bag"
    ((causes, parameters),) = diagnosed(table, table / "drive.csv", tmp_path / "table")
    assert causes == ("rotation_gain",)
    low, high = parameters["rotation_gain"]["ci95"]
    assert low <= -0.25 <= high
    copied = shutil.copytree(bag, tmp_path / "elsewhere")  # a folder is whole by itself
    program = started(copied / "make_bag.py", str(tmp_path / "drive"))
    program.communicate(timeout=600)
    ((same, _),) = diagnosed(bag, tmp_path / "drive", tmp_path / "bag")
    assert same == causes

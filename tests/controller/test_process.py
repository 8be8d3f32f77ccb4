"""The controller as a process: serves, drives on a living pose, stops without one, ends cleanly."""

import asyncio
import os
import re
import signal
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from asyncua import Client, ua

from hilserver.controller.loop import FigureOfEight, PoseWatch
from hilserver.controller.nodes import (
    NAMESPACE,
    SENSORS,
    SEQUENCE,
    SETPOINTS,
    demo_peer,
)
from hilserver.controller.path import Pose
from tests.io.opcua_client.conftest import make_harness, wait_until

STAMP = datetime(2026, 1, 1, tzinfo=UTC)
LIMIT_S = 100.0
"""Nobody waits so long, but on a busy computer."""


def test_a_pose_lives_only_while_its_stamp_moves():
    watch = PoseWatch(stale_s=0.5)
    # the node's own initial value
    assert watch.observe((0.0, 0.0, 0.0), STAMP, 0.0) is None
    later = STAMP + timedelta(seconds=1)
    assert watch.observe((1.0, 2.0, 3.0), later, 1.0) == Pose(1.0, 2.0, 3.0)
    assert watch.observe((1.0, 2.0, 3.0), later, 1.5) is not None
    assert watch.observe((1.0, 2.0, 3.0), later, 1.51) is None


@pytest.mark.parametrize("bad", [None, float("nan"), "1.0"])
def test_a_pose_with_a_hole_is_no_pose(bad):
    watch = PoseWatch()
    watch.observe((0.0, 0.0, 0.0), STAMP, 0.0)
    assert watch.observe((0.0, bad, 0.0), STAMP + timedelta(seconds=1), 0.1) is None


async def started() -> tuple[asyncio.subprocess.Process, str]:
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        *(
            "-m",
            "hilserver.controller",
            "--endpoint",
            "opc.tcp://127.0.0.1:0/UA/NodeRedAgv",
        ),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
    )
    assert process.stdout is not None
    line = (await process.stdout.readline()).decode()
    match = re.search(r"listening on (opc\.tcp://\S+)", line)
    assert match, line
    return process, match[1]


async def test_process_drives_on_a_pose_and_stops_without():
    process, endpoint = await started()
    try:
        harness = make_harness(demo_peer(endpoint, name="iot2050"))
        await harness.link.start()
        await wait_until(
            lambda: harness.gate.latest.get("wheel.fl.setpoint_rpm", 0.0) != 0.0
        )
        fl, fr = (harness.gate.latest[f"wheel.{w}.setpoint_rpm"] for w in ("fl", "fr"))
        assert fl > 0 or fr < 0
        assert harness.status.faults == {}
        await harness.link.stop()
        async with Client(endpoint) as client:
            index = await client.get_namespace_index(NAMESPACE)
            node = client.get_node(f"ns={index};s=rpm_set_FL")
            async with asyncio.timeout(LIMIT_S):
                while await node.read_value() != 0.0:  # noqa: ASYNC110 - another process
                    await asyncio.sleep(0.02)
            with pytest.raises(ua.UaStatusCodeError):
                await node.write_value(50.0)
            served = {
                n.Identifier
                for n in [
                    child.nodeid
                    for child in await client.get_node(
                        f"ns={index};s=agv"
                    ).get_children()
                ]
            }
            assert served == {*SETPOINTS, SEQUENCE, *SENSORS}
        process.send_signal(signal.SIGTERM)
        assert await asyncio.wait_for(process.wait(), LIMIT_S) == 0
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()


async def test_a_taken_port_is_one_sentence():
    process, endpoint = await started()
    try:
        second = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "hilserver.controller", "--endpoint", endpoint),
            stderr=asyncio.subprocess.PIPE,
        )
        _, errors = await asyncio.wait_for(second.communicate(), LIMIT_S)
        assert second.returncode == 1
        assert re.fullmatch(
            r"hilserver: port \d+ cannot be used: .*\n", errors.decode()
        )
    finally:
        process.kill()
        await process.wait()


async def test_ends_with_its_parent():
    """A parent that dies without a word must not leave a controller behind."""
    script = (
        "import subprocess, sys; p = subprocess.Popen([sys.executable, '-m',"
        " 'hilserver.controller', '--endpoint', 'opc.tcp://127.0.0.1:0/UA/NodeRedAgv'],"
        " stdout=subprocess.PIPE); p.stdout.readline(); print(p.pid, flush=True)"
    )
    parent = await asyncio.create_subprocess_exec(
        sys.executable, "-c", script, stdout=asyncio.subprocess.PIPE
    )
    out, _ = await parent.communicate()
    child = int(out)

    def gone() -> bool:
        try:
            return Path(f"/proc/{child}/stat").read_text().split()[2] == "Z"
        except FileNotFoundError:
            return True

    await wait_until(gone, LIMIT_S)


async def test_a_parent_that_ends_before_the_first_cycle_is_missed(monkeypatch):
    """It knows that the controller listens, and so may end, before the controller drives."""
    controller = FigureOfEight(server=None)
    monkeypatch.setattr(os, "getppid", lambda: 1)
    async with asyncio.timeout(LIMIT_S):
        await controller.run()


async def test_it_ends_without_a_word_when_its_starter_is_gone():
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        *(
            "-m",
            "hilserver.controller",
            "--endpoint",
            "opc.tcp://127.0.0.1:0/UA/NodeRedAgv",
        ),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    process.stdout._transport.close()
    async with asyncio.timeout(LIMIT_S):
        assert await process.stderr.read() == b""
        assert await process.wait() == 1

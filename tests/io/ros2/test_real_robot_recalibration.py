"""The model keeps up with a real robot that is heard over ROS 2 alone, as in ``run --twin``.

Ten minutes at real rates. What it guards is guarded piece by piece by `test_real_robot` (the values
and their stamps come in) and by `tests.recalibration` (what is made of them).
"""

import json

import pytest

from hilserver.daemon.connections import LINKS
from hilserver.recalibration import link as recalibration
from hilserver.recalibration.history import FILE
from tests.io.ros2.drives import (
    FLOATS,
    MEASURED,
    REAL,
    SETPOINTS,
    TURNS_MORE,
    recorded,
    wandering,
)
from tests.io.ros2.rig import robot
from tests.io.ros2.ros_node import RosNode, needs_rclpy
from tests.loopback.rig import wait_until

pytestmark = [needs_rclpy, pytest.mark.long, pytest.mark.timeout(3000)]

DRIVE_S = 780.0
LONGEST_S = 1500.0
TWIN = {"enabled": True, "window_s": 120, "every_s": 60, "nice": 5, "limit_s": 600}


def lines(folder, kind):
    history = folder / "recalibration" / FILE
    text = history.read_text(encoding="utf-8") if history.exists() else ""
    found = map(json.loads, text.splitlines())
    return [line for line in found if line["kind"] == kind]


@pytest.fixture
def drive(tmp_path):
    return recorded(tmp_path, wandering(tmp_path / "setpoints.csv", DRIVE_S))


async def test_the_rotation_gain_is_found_and_better_once_accepted(
    domain, tmp_path, drive
):
    node = RosNode(domain, {SETPOINTS: FLOATS} | REAL)
    beside = {"recalibration": TWIN, "sensors": {"nav": {"enabled": True}}}
    ros2 = {
        "flavour": "thesis_sil",
        "measured": MEASURED,
        "beside": beside,
        "folder": tmp_path,
    }
    links = (*LINKS, recalibration.parts)
    async with robot(domain, links=links, **ros2) as daemon, node:
        await node.is_ready()
        node.play(drive)
        await wait_until(lambda: lines(tmp_path, "proposal"), LONGEST_S)
        (found,) = lines(tmp_path, "proposal")
        assert found["proposal"]["causes"] == ["rotation_gain"]
        term = found["proposal"]["terms"]["rotation_gain"]
        print(found["proposal"])
        assert term["value"] == pytest.approx(TURNS_MORE, abs=0.01)

        await daemon.part("recalibration").accept(1, "test")
        await wait_until(lambda: lines(tmp_path, "effect"), LONGEST_S)
        (effect,) = lines(tmp_path, "effect")
        print(effect["proposal"])
        assert effect["proposal"]["stage"] == "better"
        node.process.kill()

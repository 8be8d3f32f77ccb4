"""A ROS 2 node as the controller: the robot waits for its steps, and every run is the same."""

import asyncio
import contextlib
import gc
import hashlib
import re

import pytest

from hilserver.program.children import python, started
from hilserver.signals import State
from hilserver.testing.hil import HilError
from hilserver.testing.opening import open_hil
from tests.io.ros2.rig import claimed_domain
from tests.io.ros2.ros_node import PYTHON, ROOT, needs_rclpy

pytestmark = needs_rclpy

PAGE = ROOT / "docs" / "how-to" / "ros2.md"
PATIENCE_S = 600.0
YAW, RATE = "pose.yaw_rad", "twist.angular_rad_s"
REQUIRE = [
    {"name": "arrives", "signal": YAW, "above": 0.48, "within_s": 1.4},
    {"name": "does not overshoot", "signal": YAW, "below": 0.52, "always": True},
    {"name": "keeps its limit", "signal": RATE, "below": 0.81, "always": True},
]
BUGS = {
    "": ("", "", []),
    "sign": ("TARGET_RAD - heading_rad", "heading_rad - TARGET_RAD", ["arrives"]),
    "gain": ("0.5, 4.0", "0.5, 0.5", ["arrives"]),
    "limit": ("4.0, 0.8", "4.0, 1.6", ["keeps its limit"]),
}
TIMER = """
from rclpy.parameter import Parameter

node.destroy_node()
node = rclpy.create_node(
    "by_timer", parameter_overrides=[Parameter("use_sim_time", value=True)]
)
drive = node.create_publisher(Twist, "/cmd_vel", 10)
newest = Imu()


def keep(imu):
    global newest
    newest = imu


node.create_subscription(Imu, "/imu", keep, qos_profile_sensor_data)
node.create_timer(0.02, lambda: control(newest))
"""
"""The node of the page, driven by a timer that follows ``/clock``."""


def controller(bug="", by_timer=False):
    """The node of the page, with a bug or with a timer."""
    text = next(
        block
        for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
        if "Trigger" in block
    )
    right, wrong, _ = BUGS[bug]
    assert right in text
    if right:
        text = text.replace(right, wrong)
    if by_timer:
        (line,) = re.findall(r"node.create_subscription\(.*\n", text)
        text = text.replace(line, TIMER)
    return text


@contextlib.asynccontextmanager
async def robot(beside=None, **more):
    with claimed_domain() as domain:
        node = {"enabled": True, "flavour": "diff_drive", "domain": domain}
        sections = {"ros2": node | more, "control": {"source": "ros2"}}
        sections |= beside or {}
        async with open_hil(sections, "virtual") as hil:
            yield hil
        del hil
        gc.collect()  # DDS gives a domain back when nothing of it is left


async def drive(file, parts=(1500,), **more):
    """Drive once; return which requirements are not met, and a hash of every signal."""
    async with robot(**more) as hil, hil.capture() as trace:
        async with hil.controller(PYTHON, file, patience_s=PATIENCE_S):
            for n in parts:
                await hil.step(n)
        await hil.step(100)  # its last command still stands
        found = [name for name, m in trace.margins(*REQUIRE).items() if m < 0.0]
        columns = b"".join(trace[name].values.tobytes() for name in sorted(trace))
        return found, hashlib.sha256(columns).hexdigest()


@pytest.fixture
def written(tmp_path):
    def write(*variant):
        file = tmp_path / f"{'_'.join(map(str, variant)) or 'node'}.py"
        file.write_text(controller(*variant), encoding="utf-8")
        return file

    return write


@contextlib.asynccontextmanager
async def busy(n):
    async with contextlib.AsyncExitStack() as ending:
        for _ in range(n):
            command = python("-c", "import os; os.nice(19)\nwhile True: pass")
            await ending.enter_async_context(
                started(command, name="busy", stop_limit_s=0)
            )
        yield


async def test_every_repeat_is_equal_however_the_test_steps(written):
    ways = [(1500,), (1500,), (7, 1, 41, 1451)]
    drives = [drive(written(), way) for way in ways]
    by_timer = [drive(written("", True)) for _ in range(2)]
    async with busy(2):
        done = await asyncio.gather(*drives, *by_timer)
    assert [found for found, _ in done] == [[]] * 5
    hashes = [bits for _, bits in done]
    assert len(set(hashes[:3])) == 1
    assert len(set(hashes[3:])) == 1


@pytest.mark.long
async def test_planted_bugs_are_found(written):
    for bug, (_, _, expected) in BUGS.items():
        assert (await drive(written(bug)))[0] == expected


@pytest.mark.long
@pytest.mark.parametrize("by_timer", [False, True])
async def test_two_hundred_repeats_are_equal_beside_busy_processes(written, by_timer):
    async with busy(2):
        hashes = {(await drive(written("", by_timer)))[1] for _ in range(200)}
    assert len(hashes) == 1


async def test_a_command_grows_no_older_while_its_node_computes(written):
    """Without that, 1 s of computing would be 0.1 s of silence: the safe state."""
    file = written()
    slow = "    time.sleep(1.0)\n    step.call_async"
    text = file.read_text().replace("    step.call_async", slow)
    rarely = "    if stamp_ms % 40:\n        drive.publish"
    text = text.replace("    drive.publish", rarely)
    stamp = "    stamp_ms = imu.header.stamp.nanosec // 1_000_000\n    heading_rad ="
    text = text.replace("    heading_rad =", stamp)
    file.write_text(text.replace("import math", "import math\nimport time"))
    async with (
        robot(stale_after_ms=60, on_stale="ramp") as hil,
        hil.controller(PYTHON, file, patience_s=PATIENCE_S),
    ):
        await hil.step(60)
        assert hil.read(RATE) == pytest.approx(0.8)
        assert hil.daemon.control.state is State.RUNNING


@pytest.mark.long
async def test_one_node_after_the_other(written):
    async with robot() as hil:
        for bug, rate in (("", 0.8), ("sign", -0.8)):
            async with hil.controller(PYTHON, written(bug), patience_s=PATIENCE_S):
                await hil.step(100)
                assert hil.read(RATE) == pytest.approx(rate)
            await hil.step(600)
            assert hil.read(RATE) == 0.0


async def test_a_node_with_a_clock_of_its_own_is_named(written):
    file = written()
    text = file.read_text().replace("    step.call_async(Trigger.Request())\n", "")
    text = re.sub(r"step[ .].*\n", "", text)
    again = "node.create_timer(0.02, lambda: drive.publish(Twist()))\nrclpy.spin"
    file.write_text(text.replace("rclpy.spin", again))
    async with robot() as hil:
        says = "commands and does not call Step"
        with pytest.raises(HilError, match=says):
            async with hil.controller(PYTHON, file, patience_s=PATIENCE_S):
                await hil.step(200)


async def test_a_node_gets_the_address_of_the_opcua_server_as_well():
    command = python("-c", "import sys; sys.exit(sys.argv[1])", "{endpoint}")
    async with robot() as hil:
        with pytest.raises(HilError, match=r"set opcua\.enabled"):
            async with hil.controller(*command):
                pass
    async with robot(beside={"opcua": {"enabled": True}}) as hil:
        with pytest.raises(HilError, match=f"exit code 1: {hil.endpoint}"):
            async with hil.controller(*command):
                await hil.step(20)

"""A real node plays the real robot beside the simulated one: all that shadow mode makes of it."""

import asyncio
import math
import sys
from contextlib import asynccontextmanager

import pytest
import structlog
from structlog.testing import capture_logs

from hilserver.errors import ControlRefused
from hilserver.io.ros2 import domain_watch, real_robot
from hilserver.status import (
    BAD_WAITING_FOR_INITIAL_DATA,
    GOOD,
    UNCERTAIN_LAST_USABLE_VALUE,
)
from tests.io.ros2.drives import FLOATS, MEASURED, REAL, SETPOINTS, TURNS_MORE, recorded
from tests.io.ros2.rig import PATIENCE_S, claimed_domain, robot, value
from tests.io.ros2.ros_node import ROOT, RosNode, needs_rclpy
from tests.loopback.rig import scrape, wait_until

pytestmark = needs_rclpy

DRIVE = """
steps:
  - {at_s: 0.5, write: {wheels.setpoints_rpm: [30, 30, 10, 10]}}
  - {at_s: 5.0, write: {wheels.setpoints_rpm: [-10, -10, -30, -30]}}
  - {at_s: 7.0, write: {wheels.setpoints_rpm: [0, 0, 0, 0]}}
"""
SHADOW = {"limits": {"imu.gyro_z_rad_s": 0.03}, "after_s": 0.5}
TRACKING = 2.0  # of estimate.state
BESIDE = {
    "shadow": SHADOW,
    "observer": {"enabled": True, "source": "measured"},
    "sensors": {"nav": {"enabled": True}},
}


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive")
    (folder / "drive.yaml").write_text(DRIVE, encoding="utf-8")
    return recorded(folder, folder / "drive.yaml")


def host(domain, publish=None, **more):
    return RosNode(
        domain, {SETPOINTS: FLOATS} | REAL if publish is None else publish, **more
    )


def beside(domain, **more):
    """The simulated robot, with the real one's topics under /real."""
    return robot(domain, flavour="thesis_sil", measured=MEASURED, **more)


def status(daemon, name):
    return int(daemon.image.latest().status[daemon.table.slot(name)])


def told(daemon, *words):
    return [
        e.message
        for e in daemon.events.recent
        if all(word in e.message for word in words)
    ]


async def test_gap_alarm_and_estimate_come_over_ros_2_alone(domain, drive):
    async with beside(domain, beside=BESIDE) as daemon, host(domain) as node:
        await node.is_ready()
        assert status(daemon, "measured.nav.x_m") == BAD_WAITING_FOR_INITIAL_DATA
        node.play(drive)
        await wait_until(lambda: status(daemon, "measured.nav.x_m") == GOOD, PATIENCE_S)
        daemon.control.align_pose()
        alarm = lambda: daemon.gaps.alarms["imu.gyro_z_rad_s"]  # noqa: E731
        await wait_until(alarm, PATIENCE_S)
        rate = value(daemon, "imu.gyro_z_rad_s")
        gap = daemon.outputs.model_gap()["imu.gyro_z_rad_s"]
        assert gap == pytest.approx(TURNS_MORE * rate, rel=0.2)
        assert abs(daemon.outputs.model_gap()["wheel.fl.speed_rpm"]) < 2.0
        (text,) = told(daemon, "model gap: imu.gyro_z_rad_s", "limit 0.03")
        assert "measured minus simulated" in text

        def is_tracked_and_not_simulated():
            real = value(daemon, "measured.nav.yaw_rad")
            seen, simulated = (
                abs(math.remainder(value(daemon, name) - real, math.tau))
                for name in ("estimate.yaw_rad", "pose.yaw_rad")
            )
            return (
                value(daemon, "estimate.state") == TRACKING
                and seen < 0.05 < 0.1 < simulated
            )

        await wait_until(is_tracked_and_not_simulated, PATIENCE_S)
        assert await node.answers("played")

        figures = daemon.parts_of("ros2")[1].status
        assert figures.connected
        assert figures.one_way.last_ns is not None
        assert figures.fault_counts.total() == 0
        assert 'hil_model_gap{channel="nav.yaw_rad"}' in await scrape(daemon)
        assert daemon.gate.owner == "ros2"
        await wait_until(
            lambda: status(daemon, "measured.nav.x_m") == UNCERTAIN_LAST_USABLE_VALUE,
            PATIENCE_S,
        )
        assert told(daemon, "/real/poseStamped: no new value for more than 1000 ms")
        await wait_until(lambda: not daemon.outputs.model_gap(), PATIENCE_S)


# --- what does not fit: one sentence each, and nothing of it is taken -----------------------------

SPEEDS = "/real/rpm/return"


def faults(daemon):
    """Counts and sentences of the real robot's faults."""
    figures = daemon.parts_of("ros2")[1].status
    return figures.fault_counts, list(figures.faults.values())


async def sent_until(condition, node, topic, **fields):
    """Write until it has arrived: a reader of what may be lost takes no message for granted."""
    for _ in range(1000):
        node.publish(topic, **fields)
        await asyncio.sleep(0.05)
        if condition():
            return
    raise AssertionError("it did not arrive")


async def test_a_message_that_does_not_fit_is_refused_whole(domain):
    async with beside(domain) as daemon, host(domain) as node:
        await node.is_ready()
        counts, _ = faults(daemon)
        fine = [1.0, 2.0, 3.0, 4.0]
        for data, kind, words in (
            (
                [9.0, 9.0, 9.0],
                "bad_message",
                "3 numbers instead of one for each of four wheels",
            ),
            ([9.0, 9.0, math.nan, 9.0], "refused_value", "not finite"),
            ([9.0, 9.0, 9.0, 999.0], "refused_value", "outside -200 .. 200"),
        ):
            has_come = lambda: value(daemon, "measured.wheel.rr.speed_rpm") == 4.0  # noqa: E731
            await sent_until(has_come, node, SPEEDS, data=fine)
            before = counts[kind]
            await sent_until(
                lambda n=before, k=kind: counts[k] > n, node, SPEEDS, data=data
            )
            assert value(daemon, "measured.wheel.fl.speed_rpm") == 1.0
            assert told(daemon, SPEEDS, words) or kind == "refused_value"
        assert len(told(daemon, SPEEDS, "was refused, and the rest")) == 1, (
            "one line for both"
        )
        pose = {"header": {"frame_id": "uwb"}, "pose": {"orientation": {"w": 1.0}}}
        remark = ("/real/poseStamped gives poses in 'uwb'", "ros2.measured.frame 'map'")
        await sent_until(
            lambda: told(daemon, *remark), node, "/real/poseStamped", **pose
        )
        assert status(daemon, "measured.nav.x_m") == BAD_WAITING_FOR_INITIAL_DATA


async def test_a_drive_without_a_pose_says_what_has_no_value(
    domain, drive, monkeypatch, tmp_path
):
    monkeypatch.setattr(real_robot, "SAID_ALL_NS", 500_000_000)
    lines = drive.read_text(encoding="utf-8").splitlines(keepends=True)
    without = tmp_path / "without.jsonl"
    without.write_text(
        "".join(line for line in lines if "poseStamped" not in line), "utf-8"
    )
    async with beside(domain) as daemon, host(domain) as node:
        await node.is_ready()
        node.play(without)
        missing = lambda: told(daemon, "nothing has come by")  # noqa: E731
        await wait_until(missing, PATIENCE_S)
        (text,) = missing()
        assert text.endswith("by /real/poseStamped, so measured.nav.* have no value")
        with pytest.raises(ControlRefused, match=r"AlignPose needs measured\.pose"):
            daemon.control.align_pose()


async def test_two_robots_under_one_namespace_give_nothing(domain):
    topic = {SPEEDS: FLOATS}
    nodes = host(domain, topic, name="one"), host(domain, topic, name="other")
    async with beside(domain) as daemon, nodes[0] as one, nodes[1] as other:
        for node, rpm in ((one, 10.0), (other, 20.0)):
            await node.is_ready()
            node.publish(SPEEDS, times=250, data=[rpm] * 4)
        counts, _ = faults(daemon)
        await wait_until(lambda: counts["two_robots"] > 50, PATIENCE_S)
        (text,) = told(daemon, SPEEDS, "two nodes publish it")
        assert "ros2.measured.namespace" in text
        name = "measured.wheel.fl.speed_rpm"
        await wait_until(
            lambda: status(daemon, name) == UNCERTAIN_LAST_USABLE_VALUE, PATIENCE_S
        )
        # one that pauses leaves the topic to the other, so on a busy computer it may be either
        assert value(daemon, name) in (10.0, 20.0)


async def test_a_node_in_another_domain_is_named_by_its_domain(domain, monkeypatch):
    monkeypatch.setattr(domain_watch, "ALONE_AFTER", 2)
    with claimed_domain() as elsewhere, capture_logs() as log:
        monkeypatch.setattr(domain_watch, "_log", structlog.get_logger())
        async with host(elsewhere, {SPEEDS: FLOATS}), beside(domain) as daemon:
            found = lambda: any(elsewhere in line.get("others", ()) for line in log)  # noqa: E731
            await wait_until(found, PATIENCE_S)
            assert (
                status(daemon, "measured.wheel.fl.speed_rpm")
                == BAD_WAITING_FOR_INITIAL_DATA
            )


@asynccontextmanager
async def forger(domain, topic, how):
    """A node whose messages have the right type's name and other fields."""
    command = (sys.executable, "-m", "tests.io.ros2.forger", str(domain), topic, how)
    process = await asyncio.create_subprocess_exec(
        *command, stdin=asyncio.subprocess.PIPE, cwd=ROOT
    )
    try:
        yield
    finally:
        process.stdin.close()
        await process.wait()


@pytest.mark.parametrize(
    ("topic", "how"),
    [(SPEEDS, "described"), (SPEEDS, "undescribed"), (SETPOINTS, "undescribed")],
)
async def test_a_type_with_other_fields_moves_nothing(domain, topic, how):
    async with beside(domain) as daemon, forger(domain, topic, how):
        counts = daemon.part("ros2").status.fault_counts
        await wait_until(lambda: counts["other_type"] > 1, PATIENCE_S)
        await asyncio.sleep(0.2)
        (text,) = told(daemon, topic, "with other fields than here")
        assert "RIHS01_" in text
        assert counts.total() == counts["other_type"]
        assert faults(daemon)[0].total() == 0
        assert value(daemon, "wheel.fl.setpoint_rpm") == 0.0
        assert (
            status(daemon, "measured.wheel.fl.speed_rpm")
            == BAD_WAITING_FOR_INITIAL_DATA
        )


async def test_who_also_publishes_what_the_simulated_robot_does_is_told_once(domain):
    async with beside(domain) as daemon, host(domain, {"/rpm/return": FLOATS}):
        counts = daemon.part("ros2").status.fault_counts
        await wait_until(lambda: counts["also_published"] > 2, PATIENCE_S)
        (text,) = told(daemon, "publishes /rpm/return as well")
        assert "a node of process" in text
        assert "ros2.namespace" in text

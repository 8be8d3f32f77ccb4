"""When a value was measured, and which of two topics counts: messages as they come from DDS."""

import asyncio
import time
from contextlib import asynccontextmanager

import pytest

from hilserver.io.ros2.participant import Arrival
from hilserver.io.ros2.real_robot import LATE_IN_A_ROW
from hilserver.ros.types import known_types
from hilserver.status import GOOD, UNCERTAIN_LAST_USABLE_VALUE
from hilserver.testing.opening import open_hil
from tests.io.ros2.rig import speeds
from tests.ros.messages import imu, joints

RPM = known_types().make(
    "iotbot_interface/msg/RotationSpeed", **speeds(10, -20, 30, -40)
)


@asynccontextmanager
async def heard(domain):
    """The real robot beside one in virtual time, and what hands a message to it."""
    ros2 = {
        "enabled": True,
        "domain": domain,
        "namespace": "/sim",
        "measured": "iotbot",
    }
    config = {"ros2": ros2, "observer": {"enabled": True, "source": "measured"}}
    async with open_hil(config, "virtual") as kit:
        # a value is no older than the simulation, by the wall clock
        await asyncio.sleep(0.5)
        part = kit.daemon.parts_of("ros2")[1]
        topics = {topic.name: topic for topic in part._topics}

        async def hear(topic, message, source_ns=0, writer=1):
            arrival = Arrival(known_types().encode(message), source_ns, writer)
            part._receive(topics[topic], arrival)
            await kit.run_for(0.002)

        yield kit, part, hear


def ago(message, seconds):
    """Stamp a message with a time before now [s]."""
    sec, nanosec = divmod(time.time_ns() - round(seconds * 1e9), 10**9)
    message.header.stamp = known_types().make(
        "builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec
    )
    return message


def age_s(kit):
    """How long before it came in the newest sample of the IMU was taken."""
    frame, table = kit.daemon.image.latest(), kit.daemon.table
    came, taken = (table.slot(f"internal.{what}_imu_s") for what in ("time", "taken"))
    return frame.values[came] - frame.values[taken]


async def test_a_value_is_as_old_as_its_stamp_says_or_else_its_writing(domain):
    async with heard(domain) as (kit, part, hear):

        async def is_aged(stamped_s=None, written_s=0.0):
            begun_s, expected = time.monotonic(), written_s
            message = imu() if stamped_s is None else ago(imu(), stamped_s)
            if stamped_s is not None and 0.0 <= stamped_s < 1.0:
                expected = stamped_s
            await hear("/iotbot/imu", message, time.time_ns() - round(written_s * 1e9))
            waited_s = time.monotonic() - begun_s
            assert expected - 0.01 < age_s(kit) < expected + waited_s + 0.01

        await is_aged(stamped_s=0.0)  # the first takes longer
        await is_aged(stamped_s=0.4)
        await is_aged(written_s=0.3)
        assert part.status.fault_counts.total() == 0
        for wrong_s, words in (
            (12.0, " s behind this computer's clock"),
            (-5.0, "ahead of this"),
        ):
            part._faults.expire(time.monotonic_ns() + 10**11)
            counted = part.status.fault_counts["stamp"]
            for _ in range(LATE_IN_A_ROW):
                await is_aged(stamped_s=wrong_s, written_s=0.2)
            assert not part.status.faults, "they may have waited while we stood still"
            await is_aged(stamped_s=wrong_s, written_s=0.2)
            assert part.status.fault_counts["stamp"] == counted + 1
            (sentence,) = part.status.faults.values()
            assert words in sentence
            await is_aged(stamped_s=0.1)


async def test_of_two_topics_the_first_counts_until_it_is_silent(domain):
    async with heard(domain) as (kit, part, hear):
        turning = joints(
            **{f"wheel_{wheel}": 0.5 for wheel in ("fl", "fr", "rl", "rr")}
        )
        await hear("/iotbot/rpm/return", RPM)
        await hear("/joint_states", turning)
        speed = "measured.wheel.fl.speed_rpm"
        assert (kit.read(speed), kit.status(speed)) == (10.0, GOOD)
        part.watch(time.monotonic_ns())
        part.watch(time.monotonic_ns() + 2 * 10**9)
        await kit.run_for(0.002)
        assert (kit.read(speed), kit.status(speed)) == (
            10.0,
            UNCERTAIN_LAST_USABLE_VALUE,
        )
        await hear("/joint_states", turning)
        assert kit.read(speed) == pytest.approx(0.5 * 60.0 / 6.2831853)
        assert kit.status(speed) == GOOD
        await hear("/iotbot/rpm/return", RPM)
        assert kit.read(speed) != 10.0
        assert part.status.fault_counts.total() == 0
        assert kit.daemon.gate.rejected.total() == 0

"""Shadow mode over the sockets: gap, alarm, alignment."""

import asyncio

import pytest

from tests.loopback.rig import call, configuration, inbox, running, scrape, wait_until

pytestmark = pytest.mark.asyncio
POSE = {"x_m": 2.0, "y_m": -1.0, "yaw_rad": 0.5}


async def measure(client, group="pose", **pose):
    """Write the real robot's pose, as a gateway does."""
    values = {
        f"measured__{group}__{name}": value for name, value in (POSE | pose).items()
    }
    assert set(await client.write_doubles(**values)) == {"Good"}


async def test_a_gap_is_an_alarm_until_the_pose_is_aligned():
    shadow = {"limits": {"pose.x_m": 0.3, "pose.yaw_rad": 0.1}, "after_s": 0.2}
    async with (
        running(configuration(shadow=shadow)) as (daemon, client),
        inbox(client) as box,
    ):
        assert await call(client, "AlignPose") == "BadInvalidState"
        await measure(client)
        await wait_until(
            lambda: box.has("model_gap", "pose.x_m: measured minus simulated is +2 m")
        )
        assert daemon.gaps.alarms == {"pose.x_m": True, "pose.yaw_rad": True}
        await asyncio.sleep(1.1)  # the page is made once a second
        page = await scrape(daemon)
        assert 'hil_model_gap{channel="pose.x_m"} 2' in page
        assert 'hil_model_gap_alarm{channel="pose.x_m"} 1' in page
        assert await call(client, "AlignPose") == "Good"
        await wait_until(
            lambda: box.has("model_gap", "pose.x_m is within its limit again")
        )
        frame = daemon.image.latest()
        simulated = [frame.values[daemon.table.slot(f"pose.{name}")] for name in POSE]
        assert simulated == pytest.approx(list(POSE.values()), abs=1e-9)


async def test_a_navigation_tag_is_enough_to_align():
    sensors = {"nav": {"lever_arm_x_m": 0.1}}
    async with running(configuration(sensors=sensors)) as (daemon, client):
        await measure(client, "nav", yaw_rad=0.0)

        async def aligned():
            return await call(client, "AlignPose") == "Good"

        await wait_until(aligned)
        slot = daemon.table.slot("pose.x_m")
        await wait_until(lambda: abs(daemon.image.latest().values[slot] - 1.9) < 1e-9)

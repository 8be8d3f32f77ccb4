"""The robot drives something else than commanded: that is said, once each time it begins."""

from hilserver.core.events import EventKind
from tests.loopback.rig import configuration, running, wait_until


def notices(daemon, word):
    return sum(
        e.kind is EventKind.STATE and word in e.message for e in daemon.events.recent
    )


async def test_an_exclusive_twist_and_a_scaled_twist_are_reported():
    config = configuration(plant={"exclusive_twist": True})
    async with running(config) as (daemon, _):
        write = daemon.gate.write
        assert write("opcua", {"control.mode": 1, "twist.linear_m_s": 0.3}) == {}
        await wait_until(
            lambda: daemon.image.latest().values[daemon.table.slot("pose.x_m")] > 0.05
        )
        assert notices(daemon, "exclusive_twist") == 0
        assert write("opcua", {"twist.angular_rad_s": 0.5}) == {}
        await wait_until(lambda: notices(daemon, "exclusive_twist") == 1)
        assert write("opcua", {"twist.angular_rad_s": 0.6}) == {}
        tick = daemon.scheduler.tick
        await wait_until(lambda: daemon.scheduler.tick > tick + 300)
        assert notices(daemon, "exclusive_twist") == 1


async def test_a_twist_beyond_max_rpm_is_reported():
    async with running(configuration()) as (daemon, _):
        twist = {"control.mode": 1, "twist.linear_m_s": 0.7, "twist.angular_rad_s": 2.5}
        assert daemon.gate.write("opcua", twist) == {}
        await wait_until(lambda: notices(daemon, "max_rpm") == 1)

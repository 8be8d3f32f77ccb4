"""After a silence, and after Stop: can whoever drove drive again with what he has on his wire?

In virtual time: the host's messages are handed to the node as they come from DDS. What `hold` does
takes a writer that is alive, see test_real_node.
"""

from contextlib import asynccontextmanager

import pytest

from hilserver.io.ros2.participant import Arrival
from hilserver.ros.types import known_types
from hilserver.signals import State
from hilserver.testing.opening import open_hil
from tests.io.ros2.rig import four_floats, speeds, twist

SILENT_S = 0.5
DRIVEN_BY = {
    "iotbot_shield": ("iotbot/rpm", lambda rpm: speeds(rpm, -rpm, rpm, -rpm)),
    "eduard": ("cmd_vel", lambda rpm: twist(rpm / 100.0)),
    "thesis_sil": ("rpm", lambda rpm: four_floats(rpm, rpm, -rpm, -rpm)),
    "diff_drive": ("cmd_vel", lambda rpm: twist(rpm / 100.0)),
}
MODE_REMOTE = 2


class OnTheWire:
    """A host and its robot, in virtual time."""

    def __init__(self, kit, flavour):
        self.kit, self.node = kit, kit.daemon.part("ros2")
        self._topic, self._fields = DRIVEN_BY[flavour]
        self.flavour = flavour

    async def command(self, rpm, times=10):
        """Send a command every 20 ms."""
        topics = {topic.topic: topic for _, topic, _ in reversed(self.node._ins)}
        subscribed = topics[self._topic]
        message = known_types().make(subscribed.type, **self._fields(rpm))
        for _ in range(times):
            self.node._receive(subscribed, Arrival(known_types().encode(message), 0, 1))
            await self.pass_time(0.02)

    async def is_silent(self, seconds=2 * SILENT_S):
        await self.pass_time(seconds)

    async def pass_time(self, seconds):
        for _ in range(max(1, round(seconds / 0.02))):
            await self.kit.run_for(0.02)
            self.node._see_lapse()
            self.kit.daemon.supervision.run()

    async def enable(self):
        """Call the service of the flavour that enables the drive."""
        make = known_types().make
        if self.flavour == "eduard":
            mode = make(
                "edu_robot/msg/Mode",
                mode=MODE_REMOTE,
                drive_kinematic=0,
                feature_mode=0,
            )
            request = make(
                "edu_robot/srv/SetMode_Request", mode=mode, disable_feature=0
            )
        else:
            request = make("iotbot_interface/srv/SendEnable_Request", enable=True)
        wanted = {"eduard": "set_mode"}.get(self.flavour, "send_enable")
        (service,) = [s for s in self.node._services if s.name.endswith(wanted)]
        self.node._serve(service, Arrival(known_types().encode(request), 0, 1))
        await self.pass_time(0.02)

    @property
    def is_enabled(self):
        return self.kit.read("drive.enable") == 1.0

    @property
    def drives(self):
        return abs(self.kit.read("wheel.fl.demand_rpm")) > 1.0

    def stop(self):
        self.kit.daemon.control.stop()

    def reset(self):
        self.kit.daemon.control.reset()

    @property
    def state(self):
        return self.kit.daemon.control.state


@asynccontextmanager
async def wire(domain, flavour, **ros2):
    ours = {
        "enabled": True,
        "domain": domain,
        "flavour": flavour,
        "stale_after_ms": 500,
        **ros2,
    }
    async with open_hil(
        {"ros2": ours, "control": {"source": "ros2"}}, "virtual"
    ) as kit:
        await kit.run_for(0.1)
        yield OnTheWire(kit, flavour)


FLAVOURS = tuple(DRIVEN_BY)
WITH_SERVICE = ("iotbot_shield", "eduard")


async def has_driven_and_fallen_silent(host):
    await host.command(30.0)
    assert host.drives
    await host.is_silent()
    assert not host.drives


@pytest.mark.parametrize("flavour", WITH_SERVICE)
async def test_device_a_person_enables_by_the_service_and_drives_when_he_likes(
    domain, flavour
):
    async with wire(domain, flavour, on_stale="device") as host:
        await has_driven_and_fallen_silent(host)
        await host.command(30.0)
        assert not host.drives, "a command alone enables nothing here"
        await host.is_silent()
        await host.enable()
        await host.is_silent(4 * SILENT_S)
        assert host.is_enabled, (
            "who enables by hand has not promised to command within 0.5 s"
        )
        await host.command(30.0)
        assert host.drives


@pytest.mark.parametrize("flavour", FLAVOURS)
async def test_device_a_command_after_one_at_rest_drives_where_it_may(domain, flavour):
    async with wire(domain, flavour, on_stale="device", reenable="command") as host:
        await has_driven_and_fallen_silent(host)
        await host.command(30.0)
        assert not host.drives, "what it went on sending moves nothing"
        await host.command(0.0, times=1)
        await host.is_silent()
        await host.command(30.0, times=1)
        assert host.drives, "a key that is pressed, once, after one that stops"


@pytest.mark.parametrize("flavour", FLAVOURS)
async def test_device_stop_while_disabled_takes_reset_and_a_command(domain, flavour):
    async with wire(domain, flavour, on_stale="device", reenable="command") as host:
        await has_driven_and_fallen_silent(host)
        await host.command(30.0)
        host.stop()
        for rpm in (0.0, 30.0, 0.0, 30.0):
            await host.command(rpm)
            assert not host.drives, "after Stop never by a command alone"
        assert host.state is State.SAFE
        host.reset()
        await host.pass_time(1.0)
        assert not host.drives
        await host.command(30.0)
        assert host.drives, "Reset has enabled the drive"


@pytest.mark.parametrize("flavour", WITH_SERVICE)
async def test_device_after_stop_the_service_enables_once_reset_was_called(
    domain, flavour
):
    async with wire(domain, flavour, on_stale="device") as host:
        await has_driven_and_fallen_silent(host)
        host.stop()
        await host.enable()
        await host.command(30.0)
        assert not host.drives
        host.reset()
        await host.command(0.0)
        await host.enable()
        await host.command(30.0)
        assert host.drives


async def test_zero_the_next_command_drives_as_diff_drive_controller_does(domain):
    async with wire(domain, "diff_drive") as host:
        await has_driven_and_fallen_silent(host)
        assert host.state is State.RUNNING
        await host.command(30.0, times=1)
        assert host.drives
        await host.is_silent()
        assert not host.drives
        host.stop()
        await host.command(30.0)
        host.reset()
        await host.pass_time(1.0)
        assert not host.drives, "what was commanded before is forgotten"
        await host.command(30.0)
        assert host.drives


@pytest.mark.parametrize("flavour", FLAVOURS)
async def test_ramp_takes_reset_and_a_new_command(domain, flavour):
    async with wire(domain, flavour, on_stale="ramp") as host:
        await has_driven_and_fallen_silent(host)
        assert host.state is State.SAFE
        await host.command(30.0)
        assert not host.drives
        host.reset()
        await host.pass_time(1.0)
        assert not host.drives, "what was commanded before is forgotten"
        assert host.state is State.RUNNING
        await host.command(30.0)
        assert host.drives


@pytest.mark.parametrize("flavour", WITH_SERVICE)
async def test_a_service_is_no_sign_of_life_of_who_drives(domain, flavour):
    """A node of its own may call it while the one that drives is gone."""
    async with wire(domain, flavour, on_stale="device") as host:
        await host.command(30.0)
        for _ in range(5):
            await host.enable()
            await host.is_silent(0.4 * SILENT_S)
        assert not host.drives

"""Whoever looks on does not disturb a person who drives, and every act says whose it was."""

from collections.abc import AsyncIterator

import pytest
import pytest_asyncio
from asyncua import ua

from hilserver.signals import State
from tests.io.opcua_server.rig import Rig, RobotClient

pytestmark = pytest.mark.asyncio(loop_scope="module")
S, D, B = ua.VariantType.String, ua.VariantType.Double, ua.VariantType.Byte
DENIED = "BadUserAccessDenied"


@pytest_asyncio.fixture(loop_scope="module")
async def two(rig: Rig) -> AsyncIterator[tuple[RobotClient, RobotClient]]:
    """Two browsers, of which the first drives."""
    if rig.control.state is State.STARTING:
        rig.control.started()
    browsers = [RobotClient(rig.server.url), RobotClient(rig.server.url)]
    for browser in browsers:
        browser.description = f"{rig.server.page_secret} 192.0.2.7 operator"
        await browser.connect()
    driver, other = browsers
    assert await driver.write(("control.source", "page", S)) == ["Good"]
    yield driver, other
    for browser in browsers:
        await browser.disconnect()


async def test_who_looks_on_cannot_disturb_who_drives(
    rig: Rig, two: tuple[RobotClient, RobotClient]
) -> None:
    """Before, one press gave control away, and the robot ran at full speed 1.5 s later."""
    driver, other = two
    for name, *arguments in (
        ("Pause",),
        ("Start",),
        ("Step", ua.Variant(1, ua.VariantType.UInt32)),
        ("SetSpeed", ua.Variant(2.0, D)),
        ("LoadSnapshot", ua.Variant("any", S)),
    ):
        assert (await other.call(name, *arguments)).StatusCode.name == DENIED, name
    for source in ("peer", "opcua", "nobody"):
        assert await other.write(("control.source", source, S)) == [DENIED]
    assert await other.write(("twist.linear_m_s", 0.3, D)) == [DENIED]
    assert await other.write(("lights.command", 2, B)) == [DENIED]
    assert await other.write(("measured.pose.x_m", 1.0, D)) == ["Good"]
    assert rig.control.state is State.RUNNING
    assert (await other.call("Stop")).StatusCode.name == "Good"
    assert (await other.call("Reset")).StatusCode.name == "Good"
    assert await driver.write(("lights.command", 2, B)) == ["Good"]
    assert await driver.write(("twist.linear_m_s", 0.0, D)) == ["Good"]


async def test_the_driver_may_and_it_is_told_who_did(
    rig: Rig, two: tuple[RobotClient, RobotClient]
) -> None:
    driver, other = two
    assert (await driver.call("SetSpeed", ua.Variant(2.0, D))).StatusCode.name == "Good"
    assert rig.events.recent[-1].message == "SetSpeed(2.0) by anonymous engineer"
    assert (await driver.call("SetSpeed", ua.Variant(1.0, D))).StatusCode.name == "Good"
    # the page asks before
    assert await other.write(("control.source", "page", S)) == ["Good"]
    assert (await driver.call("Pause")).StatusCode.name == DENIED
    assert await other.write(("control.source", "nobody", S)) == ["Good"]
    assert (await driver.call("Pause")).StatusCode.name == "Good"
    assert (await driver.call("Start")).StatusCode.name == "Good"

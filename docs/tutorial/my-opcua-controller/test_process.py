"""A controller that is a program of its own: robot and controller wait for each other."""

import math
import sys

import pytest

pytestmark = pytest.mark.hil(config={"opcua": {"enabled": True}})


async def test_it_turns_to_a_heading_in_time(hil):
    async with (
        hil.controller(sys.executable, "heading.py", "{endpoint}"),
        hil.capture("pose.yaw_rad") as trace,
    ):
        yield 4000
    trace["pose.yaw_rad"].assert_settles(math.pi / 2, math.radians(3), within_s=3.0)
    trace["pose.yaw_rad"].assert_overshoot(math.pi / 2, at_most=0.1)

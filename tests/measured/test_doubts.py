"""Dimensions in another unit are asked about, wherever they were written."""

import pytest

from hilserver.measured.machine import doubts
from hilserver.plant.parameters import RobotParameters


@pytest.mark.parametrize(
    ("robot", "says"),
    [
        (RobotParameters(), []),
        (
            RobotParameters(wheelbase_m=None, track_m=16.0, wheel_radius_m=0.033),
            ["track"],
        ),
        (RobotParameters(wheel_radius_m=4.0), ["track", "wheelbase"]),
    ],
)
def test_a_track_of_sixteen_metres_is_asked_about(robot, says):
    found = doubts(robot)
    assert len(found) == len(says)
    for sentence, word in zip(found, says, strict=True):
        assert f"the {word}" in sentence
        assert sentence.endswith("are both in metres?")

"""The drives are scenarios like any other: here the test kit plays one."""

import pytest

from hilserver.experiment.thesis import EXPERIMENTS, ROBOT, folder


@pytest.mark.hil(config=folder() / ROBOT, scenario=EXPERIMENTS["5.6.2"].drive)
async def test_the_test_kit_plays_a_drive_and_the_body_goes_out_and_turns_left(hil):
    yield 7000
    assert hil.read("mech.x_m") == pytest.approx(3.0 * 40.0 / 60.0 * 0.534, abs=0.05)
    yield 1000
    assert hil.read("mech.angular_rad_s") == pytest.approx(0.73, abs=0.03)

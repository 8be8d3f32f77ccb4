"""What the sensors show of a state, and its derivatives."""

import numpy as np
import pytest

from hilserver.observer.layout import N_ESTIMATED
from hilserver.observer.sensors import (
    gyro_row,
    position_rows,
    show_gyro,
    show_position,
    show_yaw,
    yaw_row,
)
from hilserver.plant.packing import pack
from tests.observer.rig import MANY, numerical, robot

STATE = np.array([0.5, -0.3, 2.2, 0.4, 0.7, 0.01, 0.02, -0.01, 0.03, 0.02, -0.03])


@pytest.fixture(params=[{}, MANY], ids=["base", "terms"])
def p(request):
    return pack(robot(**request.param))


@pytest.mark.parametrize("back", [0.0, 0.013])
def test_rows_are_the_derivatives_of_what_is_shown(p, back):
    rows, row = np.zeros((2, N_ESTIMATED)), np.zeros(N_ESTIMATED)
    position_rows(p, STATE, 0.2, back, rows)
    shown = numerical(lambda x: show_position(p, x, 0.2, back), STATE)
    np.testing.assert_allclose(rows, shown, atol=1e-8)
    yaw_row(p, STATE, back, row)
    shown = numerical(lambda x: [show_yaw(p, x, back)], STATE)
    np.testing.assert_allclose(row, shown[0], atol=1e-8)
    gyro_row(p, row)
    np.testing.assert_allclose(
        row, numerical(lambda x: [show_gyro(p, x, back, 2.0)], STATE)[0], atol=1e-8
    )


def test_the_tag_is_where_the_plant_shows_it():
    """Lever arm, scale, frame, field and distortion as the navigation's own kernel has them."""
    from hilserver.plant.layout import Outputs, State, Status  # noqa: PLC0415
    from hilserver.plant.nav import nav_step  # noqa: PLC0415

    quiet = pack(robot(**MANY))
    quiet.nav_enabled, quiet.nav_every, quiet.nav_delay, quiet.nav_yaw_delay = (
        1.0,
        1.0,
        0.0,
        0.0,
    )
    quiet.nav_white = quiet.nav_ou = quiet.nav_yaw_ou = 0.0
    y, x = Outputs.zeros(), State.zeros()
    y.pose[:] = STATE[:3]
    nav_step(quiet, x, None, y, Status.zeros())
    still = np.zeros(N_ESTIMATED)
    still[:3] = STATE[:3]
    assert show_position(quiet, still, 0.0, 0.0) == pytest.approx(y.nav[:2], abs=1e-12)
    assert np.exp(1j * show_yaw(quiet, still, 0.0)) == pytest.approx(
        np.exp(1j * y.nav[2])
    )

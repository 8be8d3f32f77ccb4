"""Where the figures of the noise come from."""

import numpy as np
import pytest

from hilserver.observer.figures import WANDER_S, MeasuredNoise, configured, figures
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.parts import Navigation
from hilserver.plant.terms import TERMS
from hilserver.plant.units import RAD_S_PER_RPM


def test_without_a_diagnosis_the_sensors_say_it():
    nav = Navigation(white_noise_m=0.02, correlated_noise_m=0.07, correlation_s=0.9)
    f = figures(RobotParameters(nav=nav), {})
    assert (f.position_sd, f.position_ou, f.position_tau) == (
        0.02,
        0.07,
        pytest.approx(0.9),
    )
    assert f.slip_sd == TERMS["wheel_radius"].reference
    assert f.gain_walk == TERMS["rotation_gain"].reference ** 2 / WANDER_S


def test_what_a_diagnosis_found_counts_instead():
    f = figures(
        RobotParameters(),
        {"nav.x_m": MeasuredNoise(0.03), "nav.y_m": MeasuredNoise(0.04)},
        unknown={},
    )
    assert f.position_sd == pytest.approx(np.sqrt((0.03**2 + 0.04**2) / 2))
    assert f.position_ou == 0.0
    assert f.slip_sd == f.slip_walk == f.bias_sd == 0.0


def test_a_side_is_the_mean_of_its_wheels_and_steps_are_noise():
    found = {
        f"wheel.{w}.speed_rpm": MeasuredNoise(0.3, step=1.2)
        for w in ("fl", "rl", "fr", "rr")
    }
    f = figures(RobotParameters(), found, unknown={})
    assert f.wheel_sd == pytest.approx(
        np.hypot(0.3, 1.2 / 12**0.5) / 2**0.5 * RAD_S_PER_RPM
    )


def test_the_correlated_part_of_a_speed_is_what_its_integral_shows():
    """Variance per second of the integral of an Ornstein-Uhlenbeck process: 2 sd^2 tau."""
    f = figures(
        RobotParameters(),
        {"imu.gyro_z_rad_s": MeasuredNoise(0.01, 0.02, 3.0)},
        unknown={},
    )
    assert f.gyro_drift == pytest.approx(2.0 * 0.02**2 * 3.0)


def test_where_the_model_has_a_slip_none_wanders_beside_it():
    f = figures(RobotParameters(terms={"longitudinal_slip": 0.1}), {})
    assert f.slip_sd == f.slip_walk == 0.0
    assert f.gain_walk > 0.0


def test_what_a_diagnosis_did_not_see_may_still_be_there():
    f = figures(RobotParameters(), {}, unknown={"rotation_gain": 0.004})
    assert (f.gain_sd, f.gain_walk) == (0.002, 0.0)


@pytest.mark.parametrize(("detectable", "sd"), [({}, 0.0), (0.004, 0.03), (0.2, 0.1)])
def test_what_wanders_is_not_bounded_by_what_a_constant_would_show(detectable, sd):
    unknown = {"rotation_gain": detectable} if detectable else {}
    f = figures(RobotParameters(), {}, unknown=unknown, wanders=True)
    assert (f.gain_sd, f.gain_walk) == (sd, pytest.approx(sd**2 / WANDER_S))


def test_every_channel_has_figures():
    assert {name.partition(".")[0] for name in configured(RobotParameters())} == {
        "wheel", "imu", "nav",
    }  # fmt: skip

"""Parameters: what is refused and how, robots with two wheels, the configuration sections."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from pydantic import ValidationError
from scipy.optimize import minimize

from hilserver.config.hall import load_hall
from hilserver.config.plant import (
    KinematicsConfig,
    PlantConfig,
    SensorsConfig,
    to_parameters,
)
from hilserver.errors import ConfigError
from hilserver.plant.errors import PlantError
from hilserver.plant.friction import balance
from hilserver.plant.packing import pack
from hilserver.plant.parameters import (
    Battery,
    Controller,
    Navigation,
    Process,
    RobotParameters,
)
from tests.plant.rig import Rig

PERIODS = {"plant": 0.001, "sensors": 0.01}


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"period_s": 0.0147}, "slice 'plant' has 14.7 ms.*unstable from 14.6 ms on"),
        ({"period_s": 0.02, "slice_name": "slow"}, "slice 'slow' has 20 ms"),
        ({"period_s": 0.0046, "discretization": "euler"}, r"less than 2 T2 = 4.6 ms"),
        ({"controller": Controller(k_p=1e4)}, "unstable from"),
        ({"controller": Controller(k_p=0.0, k_d=0.1)}, "k_p: must be above 0"),
        ({"controller": Controller(k_p=1e6)}, "no period is stable"),
        ({"process": Process(t1_s=1e-200)}, "t1_s: must be at least 1e-09"),
        ({"controller": Controller(k_i=1e300)}, "k_i: must be at most 1e"),
        ({"icr_offset_m": 0.125}, "half the wheelbase, 0.125 m"),
        ({"icr_offset_m": -0.2}, "half the wheelbase"),
        ({"wheel_radius_m": math.nan}, "finite"),
        ({"track_m": math.inf}, "finite"),
        ({"max_rpm": 0.0}, "above 0"),
        ({"wheelbase_m": -1.0}, "must be at least 0.001"),
        ({"rotation_gain": "gravel"}, "'gravel' is not a known name"),
        ({"rotation_gain": -1.0}, "yaw_sign"),
        ({"yaw_sign": 0}, "-1 or 1"),
        ({"battery": Battery(initial_charge=1.5)}, "initial_charge: must be at most 1"),
        ({"safe_ramp_s": -1.0}, "must not be negative"),
    ],
)
def test_refused(parameters, words):
    with pytest.raises(PlantError, match=words) as caught:
        RobotParameters(**parameters)
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, ConfigError)
    assert isinstance(caught.value, ValueError)


def test_navigation_rate_must_fit_its_slice():
    nav = Navigation(enabled=True, rate_hz=30.0)
    with pytest.raises(PlantError, match=r"nearest are 25 and 33\.3333 Hz"):
        pack(RobotParameters(nav=nav))


@pytest.mark.parametrize("period_s", [0.0001, 0.001, 0.01, 0.0145])
def test_every_stable_slice_settles(period_s):
    rig = (
        Rig(period_s=period_s)
        .wheels(1, 1, -1, -1)
        .step(round(30 / period_s) if period_s > 0.01 else round(1 / period_s))
    )
    assert abs(rig.y.speed[0] - 1.0) < 0.2


def test_two_wheels_have_no_wheelbase():
    robot = RobotParameters(
        wheelbase_m=None, track_m=0.55, wheel_radius_m=0.165, icr_offset_m=0.0
    )
    assert robot.k_om == pytest.approx(1 / 0.55)
    rig = (
        Rig(wheelbase_m=None, track_m=0.55, icr_offset_m=0.0).twist(0.2, 0.5).step(2000)
    )
    assert rig.velocity.tolist() == pytest.approx([0.2, 0.0, 0.5], abs=1e-7)
    with pytest.raises(PlantError, match=r"needs plant\.wheelbase_m"):
        pack(
            RobotParameters(wheelbase_m=None, terms={"friction_anisotropy.ratio": 2.0})
        )


def test_ranges_follow_max_rpm():
    robot = RobotParameters(max_rpm=90)
    assert robot.ranges == (
        90,
        pytest.approx(0.8011, abs=1e-4),
        pytest.approx(3.1316, abs=1e-3),
        0,
    )
    rig = Rig().twist(0.0, robot.max_angular_rad_s * (1 - 1e-12)).step()
    assert rig.x.scaled == 0.0
    assert max(abs(rig.x.setpoint)) == pytest.approx(90.0)


@pytest.mark.parametrize(
    ("ratio", "offset_m", "k_om", "icr_m"),
    [
        (1.0, 0.0, 1.9546, 0.0),
        (1.0, 0.01, 1.988, None),
        (1.0, 0.02, 2.104, None),
        (1.0, 0.0127, 2.009, 0.020),
        (2.24, 0.05, 1.0, 0.02),
        (2.24, 0.0, 0.31 / (0.31**2 + 2.24**2 * 0.25**2), 0.0),
    ],
)
def test_friction_anisotropy_at_known_points(ratio, offset_m, k_om, icr_m):
    found_k, found_icr = balance(0.25, 0.31, ratio, offset_m)
    assert found_k == pytest.approx(k_om, rel=0.01)
    if icr_m is not None:
        assert found_icr == pytest.approx(icr_m, abs=5e-4)


@pytest.mark.parametrize(
    ("ratio", "offset_m"), [(1.0, 0.02), (2.24, 0.05), (3.0, -0.06)]
)
def test_friction_balance_leaves_no_force_and_no_moment(ratio, offset_m):
    k_om, icr_m = balance(0.25, 0.31, ratio, offset_m)
    om, vy = 2 * k_om, -icr_m * 2 * k_om
    force = np.zeros(3)
    for front in (1, -1):
        for left in (1, -1):
            x, y = front * 0.125 - offset_m, left * 0.155
            load = 0.5 + front * offset_m / 0.25
            slip = np.array([-om * y + left, vy + om * x])
            size = math.hypot(slip[0], ratio * slip[1])
            fx, fy = -load * slip[0] / size, -load * ratio**2 * slip[1] / size
            force += (fx, fy, x * fy - y * fx)
    assert force.tolist() == pytest.approx([0, 0, 0], abs=1e-7)


@pytest.mark.parametrize(("ratio", "offset_m"), [(0.5, -0.03), (1.0, 0.1), (3.0, 0.06)])
def test_friction_balance_is_the_least_dissipation(ratio, offset_m):
    """Also where one axle does not slide at all and the minimum has a kink."""

    def dissipation(turn):
        om, vy = turn
        return sum(
            (0.5 + front * offset_m / 0.25)
            * math.hypot(
                left - om * left * 0.155, ratio * (vy + om * (front * 0.125 - offset_m))
            )
            for front in (1, -1)
            for left in (1, -1)
        )

    found_k, found_icr = balance(0.25, 0.31, ratio, offset_m)
    tight = {"xatol": 1e-12, "fatol": 1e-15, "maxiter": 4000}
    best = minimize(dissipation, [3.0, 0.0], method="Nelder-Mead", options=tight)
    assert found_k == pytest.approx(best.x[0] / 2, rel=1e-6)
    assert found_icr == pytest.approx(-best.x[1] / best.x[0], abs=1e-6)


# --- configuration --------------------------------------------------------------------------------


def test_sections_default_to_the_default_robot():
    robot = to_parameters(PlantConfig(), KinematicsConfig(), SensorsConfig(), PERIODS)
    assert pack(robot).tobytes() == pack(RobotParameters()).tobytes()


def test_sections_reach_the_robot():
    plant = PlantConfig(
        max_rpm=80, terms={"rotation_gain": -0.4}, controller={"k_p": 10.0}
    )
    kinematics = KinematicsConfig(rotation_gain="tile", yaw_sign=1)
    sensors = SensorsConfig(nav={"enabled": True, "slice": "plant"})
    robot = to_parameters(plant, kinematics, sensors, PERIODS)
    assert (robot.max_rpm, robot.k_om, robot.yaw_sign) == (80, 1.052, 1)
    assert (robot.nav.period_s, robot.imu.period_s) == (0.001, 0.01)
    assert robot.controller.k_p == 10.0
    assert robot.terms == {"rotation_gain": -0.4}


@pytest.mark.parametrize(
    ("section", "values"),
    [
        (PlantConfig, {"wheel_radius": 0.1}),
        (PlantConfig, {"max_rpm": -1}),
        (PlantConfig, {"max_rpm": math.inf}),
        (PlantConfig, {"terms": {"no_such": 1.0}}),
        (PlantConfig, {"terms": {"dead_zone": -1.0}}),
        (PlantConfig, {"discretization": "tustin"}),
        (KinematicsConfig, {"yaw_sign": 2}),
        (KinematicsConfig, {"rotation_gain": "gravel"}),
        (SensorsConfig, {"nav": {"rate_hz": 0}}),
        (SensorsConfig, {"lidar": {}}),
    ],
)
def test_sections_refuse(section, values):
    with pytest.raises(ValidationError):
        section(**values)


def test_every_key_is_described():
    for section in (PlantConfig, KinematicsConfig, SensorsConfig):
        for name, model in section.model_json_schema().get("$defs", {}).items():
            for key, value in model["properties"].items():
                assert value.get("description"), f"{name}.{key}"


def test_unknown_slice():
    with pytest.raises(PlantError, match="no slice 'sensors'; the slices are plant"):
        to_parameters(
            PlantConfig(), KinematicsConfig(), SensorsConfig(), {"plant": 0.001}
        )


def test_hall_from_a_file(tmp_path: Path):
    (tmp_path / "hall.yaml").write_text(
        "walls:\n  - [1, 2, 3, 4.5]\n  - [0, 0, 1, 0]\n"
    )
    assert load_hall("hall.yaml", tmp_path).walls.tolist() == [1, 2, 3, 4.5, 0, 0, 1, 0]
    assert load_hall("default", tmp_path).walls.size % 4 == 0


@pytest.mark.parametrize(
    "content",
    [
        "walls: [[1, 2, 3]]",
        "walls: [[1, 2, 3, .nan]]",
        "walls: 5",
        "[]",
        "a: [",
        yaml.dump({}),
    ],
)
def test_hall_refused_in_one_sentence(tmp_path: Path, content: str):
    (tmp_path / "hall.yaml").write_text(content)
    with pytest.raises(PlantError, match=r"hall\.yaml") as caught:
        load_hall("hall.yaml", tmp_path)
    assert "\n" not in str(caught.value)
    with pytest.raises(PlantError, match="cannot be read"):
        load_hall("missing.yaml", tmp_path)

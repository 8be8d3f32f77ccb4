"""The table of parameters: one source, whose values make a robot and come out of it again."""

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilserver.config.root import Config
from hilserver.parameters import PLANT, check, named, read, with_values
from hilserver.parameters.table import table_of
from hilserver.plant.blocks import BlockDeclaration, Output
from hilserver.plant.errors import PlantError
from hilserver.plant.packing import pack
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.terms import TERMS

ROOT = Path(__file__).parents[2]
AT_A_TICK = [name for name, p in PLANT.items() if p.when == "tick"]


def test_every_name_is_a_key_of_the_configuration_with_its_default():
    config = Config().model_dump()
    for name, parameter in PLANT.items():
        if name.startswith("terms."):
            assert name.removeprefix("terms.") in TERMS
            continue
        value = config
        for part in name.split("."):
            value = value[part]
        if name == "kinematics.rotation_gain":
            assert (value, math.isnan(parameter.default)) == ("geometric_skid", True)
        else:
            assert value == parameter.default, name


def test_what_a_robot_has_comes_out_and_makes_the_same_robot():
    robot = RobotParameters(
        rotation_gain="tile", terms={"rotation_gain": -0.3, "nav_lever_arm": 1}
    )
    values = read(robot)
    assert list(values) == AT_A_TICK
    assert values["kinematics.rotation_gain"] == 1.052
    assert values["terms.nav_lever_arm.x"] == 1.0
    assert math.isnan(values["terms.control_period"])
    assert pack(with_values(robot, values)).tobytes() == pack(robot).tobytes()


def test_null_is_the_gain_of_the_geometry_a_robot_with_two_wheels_or_no_limit():
    robot = with_values(
        RobotParameters(
            rotation_gain=1.2, icr_offset_m=0.0, terms={"setpoint_rate_limit": 3.0}
        ),
        dict.fromkeys(
            (
                "kinematics.rotation_gain",
                "terms.setpoint_rate_limit",
                "plant.wheelbase_m",
            ),
            math.nan,
        ),
    )
    assert (robot.rotation_gain, robot.wheelbase_m) == ("geometric_skid", None)
    assert robot.terms["setpoint_rate_limit"] is None


@pytest.mark.parametrize(
    ("name", "full"),
    [
        ("terms.nav_lever_arm", "terms.nav_lever_arm.x"),
        ("plant.terms.rotation_gain", "terms.rotation_gain"),
        ("plant.controller.k_p", "plant.controller.k_p"),
    ],
)
def test_a_bare_cause_is_its_first_part(name, full):
    assert named(name, PLANT) == full


def test_an_unknown_name_is_refused_with_the_one_that_was_meant():
    with pytest.raises(PlantError, match=r"did you mean 'plant\.controller\.k_p'"):
        named("plant.controller.kp", PLANT)


@pytest.mark.parametrize("name", PLANT)
@pytest.mark.parametrize(
    "value", [math.inf, -math.inf, 1e308, -1e308, 10**400, True, "1", [1.0]]
)
def test_what_no_parameter_can_be_is_refused_with_its_name(name, value):
    if value is True and PLANT[name].is_flag:
        return
    with pytest.raises(PlantError, match=rf"^{name}: "):
        check(PLANT[name], value)


@pytest.mark.parametrize("name", PLANT)
def test_null_is_refused_where_it_means_nothing(name):
    parameter = PLANT[name]
    if parameter.nullable and parameter.when == "tick":
        assert math.isnan(check(parameter, None))
    else:
        with pytest.raises(PlantError, match=name):
            check(parameter, math.nan)


@pytest.mark.parametrize(
    ("name", "value", "number"),
    [
        ("kinematics.rotation_gain", "tile", 1.052),
        ("kinematics.rotation_gain", "printed_5_21", 3.229),
        ("plant.exclusive_twist", True, 1.0),
        ("plant.exclusive_twist", "false", 0.0),
        ("plant.exclusive_twist", 1, 1.0),
    ],
)
def test_a_value_may_have_a_name(name, value, number):
    assert check(PLANT[name], value) == number


def test_the_name_of_the_geometry_is_null_and_another_is_none():
    assert math.isnan(check(PLANT["kinematics.rotation_gain"], "geometric_skid"))
    with pytest.raises(
        PlantError, match=r"'geometric_diff' is none of printed_5_21, .*_skid\.$"
    ):
        check(PLANT["kinematics.rotation_gain"], "geometric_diff")
    with pytest.raises(
        PlantError, match=r"exclusive_twist: must be 0 or 1, not 0\.5\.$"
    ):
        check(PLANT["plant.exclusive_twist"], 0.5)


def test_exclusive_mode_comes_out_of_a_robot_and_makes_one():
    assert read(RobotParameters(exclusive_twist=True))["plant.exclusive_twist"] == 1.0
    robot = with_values(RobotParameters(), {"plant.exclusive_twist": 1.0})
    assert robot.exclusive_twist is True


def test_the_body_needs_a_restart_and_says_so():
    with pytest.raises(PlantError, match=r"mechatronic\.tyre\.mu_lat: needs a restart"):
        check(PLANT["mechatronic.tyre.mu_lat"], 0.5)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"plant.controller.k_p": 1e6}, "unstable"),
        ({"plant.icr_offset_m": 5.0}, "half the wheelbase"),
        ({"plant.wheelbase_m": 0.03}, "half the wheelbase"),
        ({"terms.actuation_delay": 50.0}, "longer than"),
        ({"terms.control_period": 1e-5}, "below the plant slice"),
        ({"plant.max_rpm": 0.0}, "must be above 0"),
        ({"kinematics.yaw_sign": 0.5}, "must be -1 or 1"),
        ({"terms.roller_slip": 0.1}, "mecanum"),
    ],
)
def test_what_does_not_fit_the_others_is_refused(values, text):
    sound = {name: check(PLANT[name], value) for name, value in values.items()}
    with pytest.raises(PlantError, match=text):
        pack(with_values(RobotParameters(), sound))


@given(st.sampled_from(AT_A_TICK), st.floats(allow_nan=True, allow_infinity=True))
def test_whatever_is_written_makes_a_robot_or_one_sentence(name, value):
    parameter, robot = PLANT[name], RobotParameters()
    said = ""
    try:
        new = with_values(robot, {name: check(parameter, value)})
        assert len(pack(new).tobytes()) == len(pack(robot).tobytes())
    except PlantError as error:
        said = str(error)
    assert not said or ("\n" not in said and said.endswith((".", "'?")))


def test_own_blocks_have_theirs():
    declared = BlockDeclaration(
        name="load",
        function=print,
        inputs=(),
        outputs=(Output("force_n"),),
        state={},
        parameters={"gain": 0.4},
        source=ROOT / "README.md",
        source_function=print,
    )
    parameter = table_of([("cell", declared)])["blocks.cell.gain"]
    assert (parameter.default, parameter.outputs) == (0.4, ("cell.force_n",))

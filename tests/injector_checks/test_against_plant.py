"""Two programs of one contract: the injector and the plant, fed with the same set-points."""

from dataclasses import replace

import numpy as np
import pytest
from hilserver_injector import CAUSES, REQUIRED, Recipe, make, nothing, single
from hilserver_injector.recipe import WHEELS
from hilserver_injector.sensors import YAW, X, Y

from hilserver.compiled import kernel
from hilserver.plant.layout import Inputs, Outputs, Status
from hilserver.plant.packing import initial_state, pack
from hilserver.plant.parameters import MECANUM_GEOMETRY, RobotParameters
from hilserver.plant.robot import robot_step
from hilserver.plant.terms import TERMS, main_part

from .conftest import quiet

SENSORS = {
    "nav_frame_yaw", "nav_latency", "yaw_latency", "imu_latency", "gyro_bias", "gyro_scale",
    "nav_scale", "nav_lever_arm", "nav_outliers", "heading_distortion", "battery_sag",
}  # fmt: skip
SAMPLED = {"encoder_filter", "encoder_quantization"}
"""Continuous in the one and sampled in the other, or chaotic: compared more coarsely."""


@kernel()
def follow(p, x, u, y, q, ticks, setpoints, out):
    k = 0
    for tick in range(ticks[-1] + 1):
        due = tick == ticks[k]
        if due:
            for i in range(4):
                u.setpoint[i] = setpoints[k, i]
        robot_step(p, x, u, y, q)
        if due:
            out[k, :4] = y.speed
            out[k, 4:7] = y.pose
            k += 1


def differences(recipe, terms):
    table, truth = make(quiet(recipe))
    drive = (
        {"drive": "mecanum", **MECANUM_GEOMETRY} if recipe.drive == "mecanum" else {}
    )
    robot = RobotParameters(terms=terms, **drive)
    p, x = pack(robot), initial_state(robot)
    x.pose = truth.dense[0, [X, Y, YAW]]
    u, y, q = Inputs.zeros(), Outputs.zeros(), Status.zeros()
    u.enable = 1.0
    ticks = np.round(table.t_s * 1e3).astype(np.int64)

    def columns(what):
        return np.stack(
            [table.columns[f"wheel.{wheel}.{what}"] for wheel in WHEELS], axis=1
        )

    out = np.zeros((len(ticks), 7))
    follow(p, x, u, y, q, ticks, columns("setpoint_rpm"), out)
    speed = np.sqrt(np.mean((columns("speed_rpm") - out[:, :4]) ** 2))
    pose = truth.dense[ticks]
    place = np.max(np.hypot(pose[:, X] - out[:, 4], pose[:, Y] - out[:, 5]))
    return speed, place


@pytest.mark.parametrize("kind", ["drive", "bench"])
def test_nothing_hidden(kind):
    speed, place = differences(nothing(kind, 1), {})
    assert speed < 1e-3
    assert kind == "bench" or place < 1e-3


@pytest.mark.parametrize(
    "name", sorted({*REQUIRED, "body_lag", "traction_slip"} - SENSORS)
)
def test_every_cause_acts_as_its_term(name):
    recipe = replace(single(name, 2), duration_s=90.0)
    speed, place = differences(recipe, recipe.causes)
    without = differences(recipe, {})
    assert speed < (0.3 if name in SAMPLED else 0.01)
    assert recipe.kind == "bench" or place < 0.005
    changed = max(
        without[0] / 0.12, without[1] / 0.05 if recipe.kind == "drive" else 0.0
    )
    assert changed > 0.3, "the cause shows in the log"


def test_mecanum_wheels_drive_the_same_way_in_both():
    hidden = {"roller_slip": 0.1, "wheel_radius": 0.04, "wheel_radius_difference": 0.02}
    recipe = Recipe(
        drive="mecanum", manoeuvre="omni", causes=hidden, seed=2, duration_s=60.0
    )
    speed, place = differences(recipe, hidden)
    assert speed < 0.01
    assert place < 0.005
    assert differences(recipe, {**hidden, "roller_slip": 0.0})[1] > 0.05


def test_sizes_are_those_of_the_vocabulary():
    for cause in CAUSES.values():
        term = TERMS[main_part(cause.parameter)]
        if cause.required:
            assert term.reference == cause.size, cause.name
        assert term.null is None or term.null == cause.base, cause.name

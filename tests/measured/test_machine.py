"""The machine of a mapping: one for the diagnosis, the single figures and the replay."""

from dataclasses import replace

import numpy as np
import pytest

from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.diagnosis.replay.drive_stage import DriveStage
from hilserver.errors import LogError
from hilserver.measured.channels import SETPOINTS
from hilserver.measured.data import LogSource, MeasuredLog
from hilserver.measured.machine import machine, machine_config
from hilserver.measured.mapping import LogMapping
from hilserver.plant.parameters import RobotParameters
from tests.diagnosis.checks.samples import log_of

OWN = RobotParameters(rotation_gain="carpet_hard", icr_offset_m=0.03)


def log_with(**plant):
    mapping = LogMapping.model_validate(
        {"plant": plant, "channels": {"nav.x_m": {"column": "x"}}}
    )
    return MeasuredLog((LogSource("log.csv", ""),), {}, (), plant=mapping.plant_keys)


@pytest.mark.parametrize(
    "plant",
    [
        {"wheel_radius_m": 0.042, "track_m": 0.2},
        {"wheel_radius_m": 0.042, "track_m": 0.2, "wheelbase_m": None},
    ],
)
def test_two_wheels_turn_at_one_by_track_about_their_axle(plant):
    robot = machine(log_with(**plant), OWN)
    assert (robot.wheelbase_m, robot.icr_offset_m) == (None, 0.0)
    assert robot.k_om == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("plant", "expected"),
    [
        ({"track_m": 0.2, "icr_offset_m": 0.01}, (None, 0.01, 5.0)),
        ({"track_m": 0.4, "wheelbase_m": 0.3}, (0.3, 0.03, 1.036)),
        ({"wheel_radius_m": 0.1}, (0.25, 0.03, 1.036)),
        ({}, (0.25, 0.03, 1.036)),
    ],
)
def test_what_the_mapping_does_not_say_is_configured(plant, expected):
    robot = machine(log_with(**plant), OWN)
    assert (robot.wheelbase_m, robot.icr_offset_m, robot.k_om) == pytest.approx(
        expected
    )


@pytest.mark.parametrize(
    "plant",
    [
        {"wheel_radius_m": 0.042, "track_m": 0.2},
        {"track_m": 0.4, "wheelbase_m": 0.3, "icr_offset_m": 0.0},
        {"process": {"gain": 2.0}},
        {"controller": {"k_p": 2.0, "k_i": 3.0}, "max_rpm": 150},
        {"drive": "mecanum"},
    ],
)
def test_the_replay_drives_the_machine_that_the_diagnosis_judges(plant):
    given = {
        "kinematics": {"rotation_gain": 1.12},
        "plant": {"process": {"t1_s": 0.05}},
    }
    config, log = Config.model_validate(given), log_with(**plant)
    judged = machine(log, assemble_config(config).robot)
    assert assemble_config(machine_config(log, config)).robot == judged


def test_a_machine_that_does_not_fit_is_one_sentence():
    with pytest.raises(
        LogError, match=r"^log.csv: plant section of its mapping: plant.icr_offset_m"
    ):
        machine(log_with(track_m=0.05, wheelbase_m=0.03), OWN)


def test_set_points_turn_the_wheels_of_a_log_though_a_body_turns_those_of_the_robot():
    t = np.arange(0.0, 3.0, 0.02)
    log = log_of(t, {name: np.full(len(t), 30.0) for name in SETPOINTS})
    robot = machine(log, replace(RobotParameters(), body_wheels=True))
    speed, _, _ = DriveStage(log, robot, block_s=1.0).simulate({})
    assert abs(speed[-1, 0] - 30.0) < 0.5

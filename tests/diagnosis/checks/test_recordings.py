"""Measurements of real machines through the mappings of the how-to (HIL_DATA_DIR)."""

from pathlib import Path

import pytest

from hilserver.diagnosis.checks import check
from hilserver.measured.builtin import builtin_mappings
from hilserver.measured.machine import machine
from hilserver.measured.mapping import load_mapping
from hilserver.measured.reading import read_measured
from hilserver.plant.parameters import RobotParameters
from tests.helpers.recordings import recording

MAPPINGS = Path(__file__).parents[3] / "docs" / "how-to" / "mappings"


def checked(file, mapping):
    log = read_measured([file], MAPPINGS / f"{mapping}.yaml")
    return check(log, machine(log, RobotParameters()))


def causes(result):
    return {(f.causes[0], r) for f in result.findings for r in f.regressors}


@pytest.mark.parametrize(
    "path", sorted(MAPPINGS.glob("*.yaml")), ids=lambda path: path.stem
)
def test_the_mappings_of_the_how_to_are_valid(path):
    keys = load_mapping(path).plant_keys
    assert (keys["wheelbase_m"] is None) == (keys["drive"] == "skid")


@pytest.mark.parametrize("name", builtin_mappings())
def test_the_built_in_mappings_are_valid(name):
    assert load_mapping(name).is_for_bags


@pytest.mark.parametrize("floor", ["asphalt", "gravel", "sand"])
def test_the_encoder_of_the_warthog_is_held_at_4_hz(floor):
    result = checked(recording("skidsteer_drive") / f"warthog_{floor}.csv", "warthog")
    (held,) = [f for f in result.findings if "wheel.fl.speed_rpm" in f.regressors]
    assert held.causes == ("held_samples",)
    assert held.parameters["held_samples"].value == pytest.approx(4.0, rel=0.05)
    flipped = {channel for cause, channel in causes(result) if cause == "sign_flip"}
    assert flipped == ({"imu.gyro_z_rad_s"} if floor == "gravel" else set())
    assert {cause for cause, _ in causes(result)} <= {"held_samples", "sign_flip"}


def test_nothing_but_held_samples_is_wrong_with_the_husky():
    result = checked(recording("skidsteer_drive") / "husky_mixed.csv", "husky")
    assert {cause for cause, _ in causes(result)} == {"held_samples"}
    assert "imu.gyro_z_rad_s" not in {channel for _, channel in causes(result)}


def test_nothing_is_wrong_with_the_differential_drive():
    paths = sorted(recording("diffdrive_umbmark").glob("*.csv"))
    assert paths
    for path in paths:
        assert not checked(path, "diffdrive").findings, path.name

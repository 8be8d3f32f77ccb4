"""The report: the thesis's figures, the gaps, the identification, and their tables."""

import csv

import numpy as np
import pytest

from hilserver.experiment import tables
from hilserver.experiment.gaps import KINEMATIC, MECHATRONIC, beside_models
from hilserver.experiment.identification import identify
from hilserver.experiment.models import run_models
from hilserver.experiment.report.page import Third, render
from hilserver.experiment.thesis import EXPERIMENTS
from hilserver.faults.scenario import load_scenario
from hilserver.measured.channels import GYRO, IMU_YAW, SETPOINTS, TAG, YAW
from hilserver.measured.reading import read_measured
from tests.diagnosis.report.test_page import Reader
from tests.experiment.rig import BODY, ROBOT, TURN_RAD_S, circle, recording

THIRD = Third("measured", "Black: what drive.csv measured.")
NONE = "There is no mechatronic curve: it needs MuJoCo."


def page_of(name, log, body):
    experiment = EXPERIMENTS[name]
    both = beside_models(run_models(log, ROBOT, body), experiment.channels)
    identified = identify(experiment, both.courses.log, ROBOT)
    return both, render(
        experiment, both, THIRD, identified, [("Configuration", "robot.yaml")]
    )


def curves(page, title):
    """How often each model is drawn in the figure of a title."""
    figure = page.split(f"<h3>{title}</h3>")[1].split("</figure>")[0]
    return {
        role: figure.count(f'class="line {role}"')
        for role in ("measured", "simulated", "extended")
    }


def test_the_figures_of_5_6_have_three_curves_and_the_numbers_of_the_thesis():
    both, page = page_of("5.6.2", recording(), BODY)
    reader = Reader(page)
    assert reader.open == []
    assert {f"#{name}" for name in reader.ids} >= set(reader.references)
    for title, number in {
        "x over time": 49,
        "y over time": 50,
        "Path in the plane": 51,
        "Yaw over time": 52,
    }.items():
        of = curves(page, f"{title} (figure 5.{number} of the thesis)")
        assert of == {"measured": 1, "simulated": 1, "extended": 1}
    assert "Wheel speeds (figures 5.45 to 5.48 of the thesis)" in page
    assert "taken as actual speeds" in page
    assert {g.channel for g in both.gaps()} == {"place", "x", "y", "yaw"}


def test_without_a_body_the_report_says_so_and_has_two_curves():
    _, page = page_of("5.6.1", recording(), NONE)
    assert NONE in Reader(page).text
    assert curves(page, "Yaw over time (figure 5.44 of the thesis)")["extended"] == 0


def test_set_points_are_said_to_be_what_was_read():
    _, columns = circle()
    wheels = {s: columns[s.replace("setpoint", "speed")] for s in SETPOINTS}
    without = [name for name in columns if name.startswith("wheel")]
    _, page = page_of("5.6.2", recording(without, **wheels), NONE)
    assert "The wheel speeds of the recording are set-points" in page


def test_a_gap_is_that_of_the_curves():
    both, _ = page_of("5.6.2", recording(), BODY)
    found = {(g.channel, g.of, g.beside): g for g in both.gaps()}
    yaw = found["yaw", KINEMATIC, "measured"]
    assert abs(yaw.at_the_end) <= yaw.largest < 0.02
    other = found["place", MECHATRONIC, KINEMATIC]
    apart = both.courses.mechatronic - both.courses.kinematic
    assert other.largest == pytest.approx(np.hypot(apart[:, 0], apart[:, 1]).max())


@pytest.mark.parametrize("without", [(YAW,), (YAW, IMU_YAW)])
def test_where_no_yaw_was_measured_the_imu_shows_it(without):
    _, columns = circle()
    log = recording(
        (*TAG, *without), **({} if IMU_YAW in without else {IMU_YAW: columns[YAW]})
    )
    yaw = beside_models(run_models(log, ROBOT, NONE), ("turn", "yaw")).measured["yaw"]
    assert yaw.signal == (GYRO if IMU_YAW in without else IMU_YAW)
    assert yaw.values[-1] - yaw.values[0] == pytest.approx(TURN_RAD_S * 6.0, abs=0.05)


def test_5_2_identifies_what_the_thesis_did_beside_what_it_printed():
    _, page = page_of("5.2.1", recording(), NONE)
    text = Reader(page).text
    assert (
        "tile 1.052, floating floor 1.019, hard carpet 1.036, soft carpet 1.030" in text
    )
    assert f"{ROBOT.k_om:.4g} 1/m" in text
    assert "Left wheels (figure 5.4 of the thesis)" in text
    assert "Turn rate over time (figure 5.11 of the thesis)" in text


def test_what_a_recording_does_not_show_is_said_instead_of_identified():
    log = recording()
    found = identify(EXPERIMENTS["5.2.2"], log, ROBOT)
    assert any("no wheel has a step" in text for text in found.doubts)
    assert identify(EXPERIMENTS["5.6.1"], log, ROBOT) == ([], [])


def test_the_tables_are_logs_that_can_be_read_again(tmp_path):
    both, _ = page_of("5.6.2", recording(), BODY)
    files = tables.files(both)
    assert set(files) == {
        *("wheels.csv", "kinematic.csv", "mechatronic.csv", "gaps.csv"),
        *("measured_x.csv", "measured_y.csv", "measured_yaw.csv"),
    }
    (tmp_path / "wheels.csv").write_text(files["wheels.csv"])
    assert "wheel.rr.speed_rpm" in read_measured([tmp_path / "wheels.csv"])
    rows = list(csv.DictReader(files["gaps.csv"].splitlines()))
    assert rows[0]["channel"] == "place"
    assert float(rows[0]["rms"]) >= 0.0


@pytest.mark.parametrize("experiment", EXPERIMENTS.values(), ids=lambda e: e.name)
def test_every_experiment_has_a_drive_that_ends_at_rest(experiment):
    scenario = load_scenario(experiment.drive)
    assert scenario.scenario.startswith(experiment.name)
    assert not any(np.any(value) for value in scenario.steps[-1].write.values())

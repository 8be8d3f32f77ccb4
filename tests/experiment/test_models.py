"""Both models on the wheel speeds of a recording: where they start, and how they turn."""

import numpy as np
import pytest

from hilserver.errors import LogError
from hilserver.experiment.models import APART_S, run_models
from hilserver.measured.channels import GYRO, SETPOINTS, SPEEDS, TAG
from tests.diagnosis.checks.samples import log_of
from tests.experiment.rig import (
    BODY,
    LENGTH_S,
    RATE_HZ,
    ROBOT,
    START,
    TURN_RAD_S,
    circle,
    recording,
)

NONE = "There is no mechatronic curve: no reason."


def test_the_kinematic_model_follows_a_robot_that_obeys_it_from_where_the_tag_saw_it():
    courses = run_models(recording(), ROBOT, NONE)
    t, columns = circle()
    at = [np.interp(t, courses.t_s, courses.kinematic[:, k]) for k in range(3)]
    # the circle begins between two rows, at most a row early or late
    assert at[0] == pytest.approx(columns[TAG[0]], abs=0.01)
    assert at[1] == pytest.approx(columns[TAG[1]], abs=0.01)
    assert at[2] == pytest.approx(np.unwrap(columns[TAG[2]]), abs=TURN_RAD_S / RATE_HZ)
    assert courses.kinematic[0, :3] == pytest.approx(START)
    assert courses.are_measured
    assert (courses.mechatronic, courses.missing) == (None, NONE)
    assert courses.notes == ()


def test_the_mechatronic_model_begins_there_too_and_drives_nearly_the_same_circle():
    courses = run_models(recording(), ROBOT, BODY)
    assert courses.missing == ""
    assert courses.mechatronic[0, :3] == pytest.approx(START)
    apart = courses.mechatronic - courses.kinematic
    assert 0.0 < np.hypot(apart[:, 0], apart[:, 1]).max() < 0.05
    assert np.abs(apart[:, 2]).max() < 0.05


def test_a_wheel_without_a_speed_turns_as_the_other_one_of_its_side():
    every = run_models(recording(), ROBOT, NONE)
    front = run_models(recording(without=(SPEEDS[1], SPEEDS[3])), ROBOT, NONE)
    assert front.wheels_rpm == pytest.approx(every.wheels_rpm)


def test_from_set_points_the_configured_drive_turns_the_wheels():
    _, columns = circle()
    asked = {s: columns[v] for s, v in zip(SETPOINTS, SPEEDS, strict=True)}
    courses = run_models(recording(without=SPEEDS, **asked), ROBOT, NONE)
    assert not courses.are_measured
    assert courses.wheels_rpm[-1] == pytest.approx([3.0, 3.0, -45.0, -45.0], abs=0.1)
    # it overshoots, as the loop does
    assert np.abs(courses.wheels_rpm[:, 3]).max() > 45.5


@pytest.mark.parametrize("missing", [SPEEDS, (*TAG, GYRO)])
def test_a_recording_that_shows_too_little_is_refused_in_one_sentence(missing):
    with pytest.raises(
        LogError, match=r"wheel\.fl\.speed_rpm .* map their columns or topics"
    ):
        run_models(recording(without=missing), ROBOT, NONE)


def test_spans_that_began_at_one_time_stand_one_after_the_other():
    t, columns = circle()
    twice = {name: np.tile(values, 2) for name, values in columns.items()}
    courses = run_models(log_of(np.tile(t + 1.7e9, 2), twice, spans=2), ROBOT, NONE)
    assert np.all(np.diff(courses.t_s) > 0.0)
    assert courses.t_s[0] == pytest.approx(0.0, abs=1e-3)
    assert courses.t_s[-1] == pytest.approx(2.0 * LENGTH_S + APART_S, abs=0.1)
    begins = int(np.flatnonzero(np.diff(courses.span))[0]) + 1
    assert courses.kinematic[begins, :3] == pytest.approx(START, abs=1e-3)

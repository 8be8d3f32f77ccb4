"""The axis of a tracked rigid body is not that of the robot: every laboratory has one."""

import numpy as np
import pytest

from hilserver.diagnosis.checks import check
from hilserver.measured.channels import YAW
from tests.diagnosis.checks.samples import ROBOT, drive, log_of
from tests.diagnosis.checks.test_wild_samples import with_wild


def turned(degrees, **changed):
    t, columns = drive()
    yaw = columns[YAW] + np.radians(degrees)
    return log_of(t, columns | {YAW: np.angle(np.exp(1j * yaw))} | changed)


@pytest.mark.parametrize("degrees", [54.0, 89.0, -121.0])
def test_a_heading_askew_to_the_course_is_turned_back_first(degrees):
    found = check(turned(degrees), ROBOT)
    (finding,) = found.findings
    assert finding.causes == ("nav_frame_yaw",)
    assert finding.regressors == (YAW,)
    angle = finding.parameters["nav_frame_yaw"]
    assert angle.value == pytest.approx(np.radians(degrees), abs=0.02)
    assert angle.ci95[0] < np.radians(degrees) < angle.ci95[1]
    assert f"{np.degrees(angle.value):.1f} degrees" in finding.explanation
    away = np.exp(1j * (found.log[YAW].values - turned(0.0)[YAW].values))
    assert abs(np.angle(away.mean())) < 0.02


def test_wild_positions_do_not_move_it():
    _, columns = drive()
    x = np.array(columns["nav.x_m"])
    seen = np.isfinite(x)
    x[seen] = with_wild(x[seen], 300.0, 0.01, 1)
    (finding,) = check(turned(54.0, **{"nav.x_m": x}), ROBOT).findings
    assert finding.parameters["nav_frame_yaw"].value == pytest.approx(
        np.radians(54.0), abs=0.02
    )


@pytest.mark.parametrize("degrees", [0.0, 6.0, -10.0])
def test_a_small_angle_is_left_to_the_fit(degrees):
    assert check(turned(degrees), ROBOT).findings == ()


def test_an_angle_that_may_be_small_is_left_to_the_fit():
    """Errors of the position turned the course by 0.31 rad on average; that was named an axis."""
    rng = np.random.default_rng(2)
    _, columns = drive()
    moved = {}
    for name in ("nav.x_m", "nav.y_m"):
        seen = np.isfinite(columns[name])
        moved[name] = np.array(columns[name])
        moved[name][seen] += 0.03 * rng.normal(size=seen.sum())
    found = [check(turned(angle, **moved), ROBOT).findings for angle in (17.5, 24.0)]
    assert [len(one) for one in found] == [0, 1]


def test_where_the_heading_tells_nothing_no_angle_is_found():
    rng = np.random.default_rng(1)
    t, columns = drive()
    lost = np.cumsum(rng.normal(0.0, 0.3, len(t)))
    yaw = np.angle(np.exp(1j * (columns[YAW] + lost)))
    found = check(log_of(t, columns | {YAW: yaw}), ROBOT).findings
    assert not [f for f in found if f.causes == ("nav_frame_yaw",)]

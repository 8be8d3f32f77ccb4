"""Values that stand for a missing sample are no readings."""

import numpy as np
import pytest

from hilserver.diagnosis.checks import check, markers
from hilserver.diagnosis.checks.markers import far_value
from hilserver.measured.pauses import cut
from tests.diagnosis.checks.samples import ROBOT, drive, log_of

NAV = ("nav.x_m", "nav.y_m", "nav.yaw_rad")


@pytest.fixture(scope="module")
def table():
    return drive(7, length_s=100.0)


@pytest.mark.parametrize("name", ["nav.x_m", "nav.yaw_rad", "imu.gyro_z_rad_s"])
def test_a_far_value_that_comes_again_is_left_out_with_a_sentence(table, name):
    t, columns = table
    marked = np.isfinite(columns[name]) & (
        np.random.default_rng(3).random(len(t)) < 0.01
    )
    checked = check(
        log_of(t, {**columns, name: np.where(marked, -9999.0, columns[name])}), ROBOT
    )
    assert not checked.findings
    assert len(checked.log[name]) == np.isfinite(columns[name]).sum() - marked.sum()
    assert checked.log[name].values.min() > -100.0
    assert f"{name}: -9999 marks a missing sample" in checked.log.notices[0]


def test_a_position_at_zero_that_no_wheels_have_driven_to_is_none(table):
    t, columns = table
    gone = ((t > 60.0) & (t < 61.5)) | ((t > 80.0) & (t < 82.0))
    spoilt = {n: np.where(gone & np.isfinite(v), 0.0, v) if n in NAV else v
              for n, v in columns.items()}  # fmt: skip
    spoilt["nav.x_m"][np.flatnonzero(gone & np.isfinite(spoilt["nav.x_m"]))[7]] = np.nan
    log = check(log_of(t, spoilt), ROBOT).log
    assert len(log.spans) == 1
    for name in NAV:
        assert len(log[name]) == (np.isfinite(columns[name]) & ~gone).sum()
    assert "0 marks a missing sample" in log.notices[0]


def test_segments_whose_poses_begin_at_zero_lose_nothing(table):
    t, columns = table
    valid = t[np.isfinite(columns["nav.x_m"])]
    begins_s = [float(valid[valid > at_s][0]) for at_s in (0.0, 20.0, 40.0, 60.0)]
    far = {n: np.where(np.isin(t, begins_s), 0.0, columns[n] + 9.0) for n in NAV[:2]}
    log = cut(
        log_of(t, {**columns, **far}), [[(at_s, at_s + 19.0) for at_s in begins_s]]
    )
    assert markers.find(log, ROBOT) == (log, [])


def test_a_robot_that_begins_at_the_origin_and_outliers_lose_nothing(table):
    t, columns = table
    begins = {n: np.where((t < 2.0) & np.isfinite(v), 0.0, v - v[0]) if n in NAV[:2] else v
              for n, v in columns.items()}  # fmt: skip
    log = log_of(t, begins)
    assert len(check(log, ROBOT).log["nav.x_m"]) == len(log["nav.x_m"])
    x = np.random.default_rng(1).normal(0.0, 1.0, 500)
    assert far_value(np.where(np.arange(500) % 20 == 0, x + 100.0, x)) is None
    assert far_value(np.where(np.arange(500) % 20 == 0, 6.0, x)) is None
    assert far_value(np.where(np.arange(500) == 20, -9999.0, x)) is None

"""Messages that stand in a log twice count once, with the stamp of the first."""

import numpy as np
import pytest

from hilserver.diagnosis.checks import check, messages
from tests.diagnosis.checks.samples import ROBOT, drive, log_of

NAV = ("nav.x_m", "nav.y_m", "nav.yaw_rad")
WHEELS = tuple(f"wheel.{wheel}.speed_rpm" for wheel in ("fl", "rl", "fr", "rr"))


@pytest.fixture(scope="module")
def table():
    return drive(7, length_s=60.0)


def repeated(t, columns, names, came):
    """The table with the last message of a source in every row."""
    last = np.maximum.accumulate(np.where(came, np.arange(len(t)), 0))
    return {n: v[last] if n in names else v for n, v in columns.items()}


def uneven(t, mean_s):
    """Rows in which a message came, now sooner and now later."""
    at = np.cumsum(np.random.default_rng(3).gamma(2.0, 0.5 * mean_s, size=5000))
    return np.diff(np.searchsorted(at, t), prepend=-1) > 0


def test_a_source_without_a_rhythm_is_a_slow_one(table):
    t, columns = table
    there = np.isfinite(columns["nav.x_m"])
    t, columns = t[there], {n: v[there] for n, v in columns.items()}
    came = uneven(t, 0.2)
    (finding,) = check(log_of(t, repeated(t, columns, NAV, came)), ROBOT).findings
    log = check(log_of(t, repeated(t, columns, NAV, came)), ROBOT).log
    assert finding.causes == ("held_samples",)
    assert set(finding.regressors) == set(NAV)
    assert finding.parameters["held_samples"].value == pytest.approx(came.sum() / t[-1], rel=0.02)
    assert all(np.array_equal(log[name].t_s, t[came]) for name in NAV)


@pytest.mark.parametrize("share", [0.03, 0.3])
def test_messages_that_fail_to_come_are_dropouts(table, share):
    t, columns = table
    came = np.random.default_rng(4).random(len(t)) > share
    came[0] = True
    checked = check(log_of(t, repeated(t, columns, WHEELS, came)), ROBOT)
    (finding,) = checked.findings
    assert finding.causes == ("dropouts",)
    assert finding.parameters["dropouts"].value == pytest.approx((~came).mean())
    assert all(np.array_equal(checked.log[name].t_s, t[came]) for name in WHEELS)


def test_a_tag_at_rest_whose_readings_stay_is_left_as_it_is(table):
    t, columns = table
    there = np.isfinite(columns["nav.x_m"])
    rest = np.where((t > 20.0) & (t < 40.0), np.searchsorted(t, 20.0 + 0.05), np.arange(len(t)))
    still = {n: np.where(there, v[rest], np.nan) if n in NAV else v for n, v in columns.items()}
    log, found = messages.find(log_of(t, still), ROBOT)
    assert not found
    assert len(log["nav.x_m"]) == there.sum()

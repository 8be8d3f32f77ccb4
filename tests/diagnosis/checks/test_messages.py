"""Messages that stand in a log twice count once, with the stamp of the first."""

import numpy as np
import pytest

from hilserver.diagnosis.checks import check, messages
from tests.diagnosis.checks.samples import ROBOT, drive, log_of

NAV = ("nav.x_m", "nav.y_m", "nav.yaw_rad")
WHEELS = tuple(f"wheel.{wheel}.speed_rpm" for wheel in ("fl", "rl", "fr", "rr"))
DUTIES = tuple(name.replace("speed_rpm", "duty_pct") for name in WHEELS)


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
    assert finding.parameters["held_samples"].value == pytest.approx(
        came.sum() / t[-1], rel=0.02
    )
    assert all(np.array_equal(log[name].t_s, t[came]) for name in NAV)


@pytest.mark.parametrize("share", [0.03, 0.3])
def test_messages_that_fail_to_come_are_dropouts(table, share):
    t, columns = table
    came = np.random.default_rng(4).random(len(t)) > share
    came[0] = True
    checked = check(log_of(t, repeated(t, columns, WHEELS, came)), ROBOT)
    (finding,) = checked.findings
    assert finding.causes == ("dropouts",)
    assert finding.parameters["dropouts"].value == pytest.approx(
        (~came).mean(), rel=0.01
    )
    assert all(np.array_equal(checked.log[name].t_s, t[came]) for name in WHEELS)


def test_a_tag_at_rest_whose_readings_stay_is_left_as_it_is(table):
    t, columns = table
    there = np.isfinite(columns["nav.x_m"])
    rest = np.where(
        (t > 20.0) & (t < 40.0), np.searchsorted(t, 20.0 + 0.05), np.arange(len(t))
    )
    still = {
        n: np.where(there, v[rest], np.nan) if n in NAV else v
        for n, v in columns.items()
    }
    log, found = messages.find(log_of(t, still), ROBOT)
    assert not found
    assert len(log["nav.x_m"]) == there.sum()


def stop_and_go(length_s=120.0):
    """The table of a drive with a stop of 0.4 to 1 s every few seconds; its stops."""
    t, columns = drive(8, length_s=length_s)
    there = np.isfinite(columns["nav.x_m"])
    columns = {
        n: np.interp(t, t[there], v[there]) if n in NAV else v
        for n, v in columns.items()
    }
    for name in NAV:
        columns[name] += 0.01 * np.random.default_rng(len(name)).standard_normal(len(t))
    rng = np.random.default_rng(9)
    at = np.cumsum(
        np.column_stack([rng.uniform(2.0, 4.0, 60), rng.uniform(0.4, 1.0, 60)])
    )
    stands = np.searchsorted(at, t) % 2 == 1
    for name in WHEELS:
        setpoint = name.replace("speed_rpm", "setpoint_rpm")
        columns[setpoint] = np.where(stands, 0.0, columns[setpoint])
        columns[name] = np.where(
            stands, 0.1 * rng.standard_normal(len(t)), columns[name]
        )
    return t, columns, stands


def zero(columns, stands):
    return {
        n: np.where(stands, 0.0, v) if n in WHEELS else v for n, v in columns.items()
    }


def no_duty(columns, stands):
    noise = np.random.default_rng(5).standard_normal((4, len(stands)))
    duties = zip(DUTIES, WHEELS, noise, strict=True)
    return columns | {
        d: np.where(stands, 0.0, 0.6 * columns[w] + n) for d, w, n in duties
    }


def all_at_the_limit(columns, stands):
    noise = np.random.default_rng(5).standard_normal((4, len(stands)))
    duties = zip(DUTIES, WHEELS, noise, strict=True)
    return columns | {
        d: np.where(~stands, 0.6 * columns[w] + n, 100.0) for d, w, n in duties
    }


def still_pose(columns, stands):
    """That of a filter that knows when the wheels stand, and answers a tenth of a second late."""
    stays = np.convolve(stands, np.ones(5), "full")[: len(stands)] > 0
    last = np.maximum.accumulate(np.where(stays, 0, np.arange(len(stands))))
    return {n: v[last] if n in NAV else v for n, v in columns.items()}


@pytest.mark.parametrize("at_rest", [zero, no_duty, all_at_the_limit, still_pose])
def test_a_robot_that_stands_for_a_moment_repeats_no_message(at_rest):
    t, columns, stands = stop_and_go()
    checked = check(log_of(t, at_rest(columns, stands)), ROBOT)
    assert not checked.findings
    assert all(len(channel) == len(t) for channel in checked.log.channels.values())


def test_messages_that_fail_to_come_are_seen_beside_short_stops():
    t, columns, _ = stop_and_go()
    came = np.random.default_rng(4).random(len(t)) > 0.1
    came[0] = True
    (finding,) = check(log_of(t, repeated(t, columns, NAV, came)), ROBOT).findings
    assert finding.causes == ("dropouts",)
    assert finding.parameters["dropouts"].value == pytest.approx(
        (~came).mean(), rel=0.1
    )


def test_a_long_rest_has_no_part_in_the_rate_of_a_slow_source(table):
    t, columns = table
    there = np.isfinite(columns["nav.x_m"])
    t, columns = t[there], {n: v[there] for n, v in columns.items()}
    came = uneven(t, 0.2) & ~((t > 20.0) & (t < 35.0))
    (finding,) = check(log_of(t, repeated(t, columns, NAV, came)), ROBOT).findings
    assert finding.causes == ("held_samples",)
    rate_hz = finding.parameters["held_samples"].value
    assert rate_hz == pytest.approx(came.sum() / (t[-1] - 15.0), rel=0.05)

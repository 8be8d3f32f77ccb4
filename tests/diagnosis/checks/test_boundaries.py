"""Each number that decides a data check: a case on either side of it."""

from types import SimpleNamespace

import numpy as np
import pytest

from hilserver.diagnosis import thresholds as at
from hilserver.diagnosis.checks import (
    blocked,
    clocks,
    comb,
    frame,
    limited,
    orientation,
    repetitions,
    runs,
    standstill,
    too_fast,
    units,
)
from hilserver.diagnosis.checks.motion import Line
from hilserver.measured import lag as late
from hilserver.measured import thresholds as of_files
from hilserver.measured.channels import GYRO, SETPOINTS, SPEEDS
from hilserver.measured.data import Channel
from tests.diagnosis.checks.samples import ROBOT, log_of

LESS, MORE = 0.9, 1.1
RAD_S = np.pi / 30.0
ROW_S = 0.02


def channel(values, row_s=ROW_S):
    values = np.asarray(values, float)
    return Channel(
        np.arange(len(values)) * row_s, values, np.zeros(len(values), dtype=np.int64)
    )


def log(columns, n=400):
    t = np.arange(n) * ROW_S
    return log_of(
        t, {name: np.broadcast_to(v, n).astype(float) for name, v in columns.items()}
    )


def noise(n, seed=0):
    return np.random.default_rng(seed).normal(size=n)


def still(rpm):
    return standstill.stood_still(log(dict.fromkeys(SPEEDS, rpm)))


def too_fast_said(share_beyond):
    fast = log({SETPOINTS[0]: ROBOT.max_rpm * (1.0 + share_beyond), SPEEDS[0]: 0.0})
    return bool(too_fast.find(fast, ROBOT)[0].notices)


def speed_moved(rpm):
    return repetitions.should_change(
        log({SETPOINTS[0]: np.linspace(0.0, rpm, 400), SPEEDS[0]: 1.0}), SPEEDS[0]
    )


def constant(samples):
    return repetitions.is_constant(channel(np.ones(samples)))


def zigzag(share):
    steps = np.ones(1001)
    steps[: 2 * round(share * 500) : 2] = -1.0
    return runs.alternates(steps)


def asked_of(turn, gyro, more=None):
    rpm = np.full(400, turn / (2.0 * ROBOT.wheel_radius_m * ROBOT.k_om * RAD_S))
    left, right = (dict.fromkeys(names, rpm) for names in (SPEEDS[:2], SPEEDS[2:]))
    return log({**left, **right, GYRO: gyro, **(more or {})})


def on_a_frame(share):
    """The wheels turn it at 0.5 rad/s."""
    return frame.unidentified(asked_of(0.5, share * 0.5), ROBOT) is None


def turns_enough(rad_s):
    """Without a position."""
    return frame.unidentified(asked_of(rad_s, rad_s), ROBOT) is None


def beyond_a_limit(share):
    rng = np.random.default_rng(1)
    asked = rng.uniform(-0.8, 0.8, 400)
    asked[:100] = 1.0 + share
    return limited._limit(np.clip(asked, -1.0, 1.0), asked) is not None


def at_a_limit(readings):
    asked = np.random.default_rng(1).uniform(-0.8, 0.8, 400)
    asked[: round(readings)] = 1.5
    return limited._limit(np.clip(asked, -1.0, 1.0), asked) is not None


def spell(windows):
    begin = np.arange(20) * 1.0
    is_blocked = (begin >= 5.0) & (begin < 5.0 + windows)
    return bool(
        blocked._spells(is_blocked, SimpleNamespace(begin=begin, end=begin + 2.0))
    )


def blocked_way(way_m):
    """After a drive the wheels ask for a way in every 2 s, and the robot stays."""
    speed = np.concatenate(
        [np.full(2500, 0.3), np.full(300, 0.5 * way_m), np.zeros(200)]
    )
    x = np.minimum(np.arange(3000), 2500) * ROW_S * 0.3
    rpm = speed / (ROBOT.wheel_radius_m * RAD_S)
    wheels = {**dict.fromkeys(SPEEDS[:2], rpm), **dict.fromkeys(SPEEDS[2:], -rpm)}
    driven = log({**wheels, "nav.x_m": x, "nav.y_m": 0.0, GYRO: 0.0}, 3000)
    return bool(blocked.find(driven, ROBOT)[0].notices)


def lag(offset_s=0.0, offset_sd_s=1e-4, drift=0.0, drift_sd=1e-9):
    return late.Lag(offset_s, offset_sd_s, drift, drift_sd, 300.0, 600.0)


def one_drifting_clock(sd):
    """Heading and position drift apart by so many deviations; both say the clock is off."""
    drifts, _ = clocks._judge(
        [lag(0.07, drift=4e-4), lag(0.07, 8e-3, 4e-4 - sd * 1e-4, 1e-4)]
    )
    return drifts


def clock_line(chunks):
    n = round(chunks)
    return (
        late._line_through(np.arange(n) * 30.0, np.full(n, 0.2), 600.0, 0.06)
        is not None
    )


def factor_known(ratio=1e3, correlation=0.99):
    return units._known(Line(ratio, correlation, 100), units.WHEEL) is not None


def against(correlation):
    rng = np.random.default_rng(3)
    rate = rng.normal(size=20_000)
    other = rng.normal(size=20_000)
    both = -correlation * rate + np.sqrt(1.0 - correlation**2) * other
    return orientation._against(both, rate)


def need_not_turn(rad_s):
    """Its position tells of its kinematics, unless it should have turned."""
    return (
        frame.unidentified(
            asked_of(rad_s, 0.0, {"nav.x_m": 0.0, "nav.y_m": 0.0}), ROBOT
        )
        is None
    )


def combed(samples):
    values = np.rint(30.0 * noise(round(samples)))
    return bool(comb._suspects([values], [values + 0.3 * noise(len(values), 1)]))


@pytest.mark.parametrize(
    ("decides", "holds", "fails"),
    [
        pytest.param(still, LESS * at.STILL_RPM, MORE * at.STILL_RPM, id="STILL_RPM"),
        pytest.param(too_fast_said, 1.1 * at.NEGLIGIBLE, 0.9 * at.NEGLIGIBLE, id="NEGLIGIBLE"),
        pytest.param(
            speed_moved, MORE * at.LARGE_STEP_RPM, LESS * at.LARGE_STEP_RPM, id="LARGE_STEP_RPM"
        ),
        pytest.param(constant, at.FEWEST_SAMPLES, at.FEWEST_SAMPLES - 1, id="FEWEST_SAMPLES"),
        pytest.param(zigzag, MORE * at.ALTERNATING, LESS * at.ALTERNATING, id="ALTERNATING"),
        pytest.param(on_a_frame, MORE * at.STANDS, LESS * at.STANDS, id="STANDS"),
        pytest.param(
            turns_enough,
            MORE * at.SLOWEST_TURN_RAD_S,
            LESS * at.SLOWEST_TURN_RAD_S,
            id="SLOWEST_TURN_RAD_S",
        ),
        pytest.param(
            beyond_a_limit, MORE * at.LIMITED_BEYOND, LESS * at.LIMITED_BEYOND, id="LIMITED_BEYOND"
        ),
        pytest.param(at_a_limit, at.FEWEST_PIECES, at.FEWEST_PIECES - 1, id="FEWEST_PIECES"),
        pytest.param(
            blocked_way, MORE * at.BLOCKED_LEAST_WAY_M, LESS * at.BLOCKED_LEAST_WAY_M,
            id="BLOCKED_LEAST_WAY_M",
        ),
        pytest.param(spell, at.BLOCKED_FEWEST, at.BLOCKED_FEWEST - 1, id="BLOCKED_FEWEST"),
        pytest.param(
            lambda s: lag(s).is_off, MORE * of_files.CLOCK_LEAST_S, LESS * of_files.CLOCK_LEAST_S,
            id="CLOCK_LEAST_S",
        ),
        pytest.param(
            lambda sd: lag(-0.1 * sd, 0.1).is_early,
            MORE * of_files.CLOCK_SURE_SD, LESS * of_files.CLOCK_SURE_SD,
            id="CLOCK_SURE_SD",
        ),
        pytest.param(
            clock_line, of_files.CLOCK_FEWEST_CHUNKS, of_files.CLOCK_FEWEST_CHUNKS - 1,
            id="CLOCK_FEWEST_CHUNKS",
        ),
        pytest.param(
            lambda c: factor_known(correlation=c), 0.81, 0.79, id="UNIT_ALIKE"
        ),
        pytest.param(
            lambda by: factor_known(1e3 * by), LESS * at.UNIT_CLOSE, MORE * at.UNIT_CLOSE,
            id="UNIT_CLOSE",
        ),
        pytest.param(
            factor_known, MORE * at.UNITY, LESS * at.UNITY, id="UNITY"
        ),
        pytest.param(against, 0.8, 0.5, id="SIGN_SURE"),
        pytest.param(
            need_not_turn, LESS * at.TURNS_RAD_S, MORE * at.TURNS_RAD_S, id="TURNS_RAD_S"
        ),
        pytest.param(combed, at.COMB_FEWEST, at.COMB_FEWEST - 1, id="COMB_FEWEST"),
    ],
)  # fmt: skip
def test_a_check_decides_at_its_number(decides, holds, fails):
    assert decides(holds)
    assert not decides(fails)


def test_two_drifts_of_one_clock_agree_unless_clearly_apart():
    """What 11 stretches of a position say of a drift is off by four deviations now and then."""
    assert one_drifting_clock(LESS * of_files.CLOCK_SURE_SD)
    assert not one_drifting_clock(MORE * of_files.CLOCK_SURE_SD)

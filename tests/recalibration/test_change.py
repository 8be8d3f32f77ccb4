"""The change of a gap: usual scatter is none, a larger gap is one, whatever its unit and sign."""

import math

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st

from hilserver.recalibration.change import (
    FEWEST_USUAL,
    GAP_BLOCK_S,
    NEWEST,
    ChangeDetector,
    Residuals,
    grown,
)

SEEDS = st.integers(0, 10_000)


def course(rng, n, r=0.0):
    """Give an autocorrelated series of unit variance."""
    out = np.zeros(n)
    for k in range(n):
        last = out[k - 1] if k else rng.standard_normal()
        out[k] = r * last + math.sqrt(1.0 - r * r) * rng.standard_normal()
    return out


def alarms(values, detector):
    return [
        k for k, value in enumerate(values) if detector.take({"a": value}) is not None
    ]


def test_a_larger_gap_is_found_within_a_few_blocks():
    values = course(np.random.default_rng(1), 300)
    values[200:] += 5.0
    first = alarms(values, ChangeDetector())[0]
    assert 200 <= first <= 200 + NEWEST[-1]


def test_a_smaller_gap_is_no_change():
    values = course(np.random.default_rng(2), 300)
    values[200:] -= 5.0
    assert not alarms(values, ChangeDetector())


@hypothesis.given(seed=SEEDS, r=st.floats(0.0, 0.7))
@hypothesis.settings(max_examples=20, deadline=None)
def test_usual_scatter_is_no_change_however_alike_neighbours_are(seed, r):
    assert not alarms(course(np.random.default_rng(seed), 150, r), ChangeDetector())


def test_neighbours_that_are_alike_say_less():
    rng = np.random.default_rng(3)
    free, alike = (course(rng, 4000, r)[:, None] for r in (0.0, 0.8))
    shares = [
        np.mean([grown(rows[k : k + 120], 12)[0] < 0.05 for k in range(0, 3800, 40)])
        for rows in (free, alike)
    ]
    assert max(shares) < 0.2  # without the autocorrelation 0.3 of the second


def test_a_restart_forgets_what_was_usual():
    detector = ChangeDetector()
    assert not alarms(course(np.random.default_rng(4), 60), detector)
    detector.restart()
    assert not alarms(5.0 + course(np.random.default_rng(5), FEWEST_USUAL), detector)


def drive(residuals, seconds, gap, *, moves=True, from_s=0.0):
    blocks = []
    for k in range(round(seconds * 10)):
        t_s = from_s + k * 0.1
        x = 0.5 * t_s
        measured = {
            "wheel.fl.speed_rpm": 40.0 + gap,
            "pose.x_m": x * (1 + gap),
            "pose.y_m": 0.0,
        }
        simulated = {"wheel.fl.speed_rpm": 40.0, "pose.x_m": x, "pose.y_m": 3.0}
        blocks.append(residuals.take(t_s, measured, simulated, moves=moves))
    return [block for block in blocks if block]


@hypothesis.given(gap=st.floats(0.01, 10.0))
def test_a_gap_of_either_sign_is_the_same(gap):
    one, other = (drive(Residuals(), 25.0, sign * gap)[0] for sign in (1, -1))
    assert one["wheel.fl.speed_rpm"] == pytest.approx(math.log(gap**2), abs=1e-3)
    assert one["wheel.fl.speed_rpm"] == pytest.approx(other["wheel.fl.speed_rpm"])


def test_integrals_are_compared_by_what_they_gain():
    block = drive(Residuals(), 25.0, 0.1)[0]
    assert block["pose.x_m"] == pytest.approx(2.0 * math.log(0.05), abs=0.1)


def test_a_robot_at_rest_says_nothing():
    assert not drive(Residuals(), 10 * GAP_BLOCK_S, 1.0, moves=False)


def test_a_clock_that_goes_back_begins_anew():
    residuals = Residuals()
    drive(residuals, 25.0, 1.0, from_s=1000.0)
    assert len(drive(residuals, 25.0, 1.0)) == 2


@pytest.mark.parametrize("lie", [0.0, 1e9, -1e9, 1e200, -1e308])
def test_a_robot_that_lies_is_a_change_whatever_it_says(lie):
    residuals, detector = Residuals(1.0), ChangeDetector(1.0)
    rng, found = np.random.default_rng(1), []
    for k in range(600):
        t_s = 0.1 * (k if k < 400 else k - 300)  # its clock goes back
        noise = rng.standard_normal(2)
        is_lying = k >= 300
        measured = {
            "wheel.fl.speed_rpm": lie if is_lying else 40.0 + noise[0],
            "pose.x_m": lie if is_lying and k % 40 else t_s + 0.01 * noise[1],
            "pose.y_m": 0.0,
            "pose.yaw_rad": lie if is_lying else 0.0,
        }
        simulated = {
            "wheel.fl.speed_rpm": 40.0,
            "pose.x_m": t_s,
            "pose.y_m": 0.0,
            "pose.yaw_rad": 0.0,
        }
        block = residuals.take(t_s, measured, simulated, moves=True)
        assert all(map(math.isfinite, block.values()))
        found.append(detector.take(block))
    assert not any(found[:300])
    assert "wheel.fl.speed_rpm" in found

"""The budget: a year spends what it may, however many looks it has."""

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st

from hilserver.recalibration.flips import FlipTest, fewest_blocks, gains, seen
from hilserver.recalibration.spending import (
    LONGEST_S,
    NAMED_LEVEL,
    WEAKEST,
    YEAR_S,
    Spending,
)


@hypothesis.given(
    pauses=st.lists(st.floats(60.0, 1e6), min_size=1, max_size=50),
    rate=st.floats(0.1, 10.0),
)
def test_looks_spend_no_more_than_the_time_brings_in(pauses, rate):
    spending = Spending(rate)
    spent = sum(NAMED_LEVEL * spending.confirmation(pause) for pause in pauses)
    assert spent <= rate * sum(pauses) / YEAR_S * (1 + 1e-9)


def test_a_look_every_half_hour():
    assert Spending(1.0).joint(1800.0) == pytest.approx(5.7e-5, rel=0.01)
    assert Spending(1.0).confirmation(1800.0) == pytest.approx(5.7e-3, rel=0.01)


def test_a_long_pause_saves_nothing_up():
    assert Spending().confirmation(1e9) == WEAKEST
    assert Spending().joint(1e9) == Spending().joint(LONGEST_S)


def test_few_blocks_are_no_test():
    rng = np.random.default_rng(0)
    answer = gains(np.full(8, 100.0), rng)
    assert answer == FlipTest(2.0**-8, 2.0**-8, 8)
    assert answer.holds(0.01)
    assert not answer.resolves(0.001)
    assert not answer.holds(0.001)
    assert fewest_blocks(0.001) == 10


def test_nothing_to_compare_is_no_gain():
    assert gains(np.zeros(30), np.random.default_rng(0)).p == 1.0


@pytest.mark.parametrize(
    ("shown", "counted"),
    [
        (np.full(72, 2.0), 72),  # little in each, and enough in all
        (np.full(72, 1e-3), 0),  # noise at rest
        (np.append(np.full(71, 1e-3), 100.0), 1),  # it moved in one block
        (np.append(np.full(67, 1e-3), np.full(5, 2.0)), 0),
        (np.zeros(0), 0),
    ],
)
def test_blocks_count_in_which_two_models_differ_by_what_noise_lets_be_seen(
    shown, counted
):
    differences = np.random.default_rng(0).standard_normal(len(shown))
    assert gains(seen(differences, shown), np.random.default_rng(0)).blocks == counted


def test_many_blocks_state_the_resolution_of_the_flips():
    rng = np.random.default_rng(0)
    answer = gains(5.0 + rng.standard_normal(72), rng)
    assert answer.p == answer.resolution < 1e-5


@pytest.mark.parametrize("tails", ["normal", "heavy"])
def test_a_model_that_is_no_better_gains_as_seldom_as_the_level_says(tails):
    rng = np.random.default_rng(7)
    draw = rng.standard_normal if tails == "normal" else lambda n: rng.standard_t(2, n)
    differences = [
        2.0 * draw(14) * rng.uniform(0.2, 3.0, 14) - 0.05 for _ in range(400)
    ]
    found = sum(gains(d, rng).holds(0.05) for d in differences)
    assert found <= 32  # 20 are expected, 32 are beyond 99.5 %

"""The screen says nothing where there is nothing, whatever the noise, and speaks where there is."""

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st
from scipy import stats

from hilserver.diagnosis.regression.linear import orthogonal
from hilserver.diagnosis.regression.screen import (
    Blocks,
    adjusted,
    critical,
    freedom_of,
    normal,
    null_maxima,
    score,
    student,
)
from hilserver.diagnosis.thresholds import SCREEN_LEVEL
from tests.diagnosis.assertions import family_wise_error_holds
from tests.diagnosis.toy import ornstein_uhlenbeck, smooth

N_BLOCKS, PER_BLOCK, COLUMNS = 40, 50, 12


def null_draws(n, *, tau_s=0.6, seed=1, scale=lambda rng, m: 1.0):
    """Logs without an effect: noise that nobody has whitened inside the blocks, smooth columns."""
    rng = np.random.default_rng(seed)
    m = N_BLOCKS * PER_BLOCK
    block = np.repeat(np.arange(N_BLOCKS), PER_BLOCK)
    for _ in range(n):
        base = [smooth(rng, m) for _ in range(COLUMNS // 2)]
        # confusable with the first half
        mixed = [c + 0.2 * smooth(rng, m) for c in base]
        parts = [ornstein_uhlenbeck(rng, PER_BLOCK, tau_s) for _ in range(N_BLOCKS)]
        left = np.concatenate(parts) * scale(rng, m)
        yield np.stack([*base, *mixed], axis=1), left, block


def test_the_family_wise_error_holds_under_autocorrelation():
    family_wise_error_holds(null_draws(300), level=SCREEN_LEVEL, most=0.01)


def test_the_family_wise_error_holds_where_the_noise_changes_from_block_to_block():
    def uneven(rng, m):
        return np.repeat(rng.choice([0.3, 1.0, 3.0], size=N_BLOCKS), PER_BLOCK)

    draws = null_draws(300, tau_s=0.2, seed=2, scale=uneven)
    family_wise_error_holds(draws, level=SCREEN_LEVEL, most=0.01)


def test_an_effect_is_found_and_its_size_too():
    rng = np.random.default_rng(3)
    found = []
    for columns, left, block in null_draws(20, seed=3):
        blocks = Blocks.of(block, N_BLOCKS)
        k = int(rng.integers(COLUMNS // 2))
        s = score(columns, left + 6.0 * columns[:, k], blocks)
        limit = critical(null_maxima([s], rng, flips=999))
        found.append(abs(s.t[k]) > limit)
        assert s.size[k] == pytest.approx(
            6.0, abs=5.0 * s.deviation[k] / s.information[k]
        )
    assert np.mean(found) > 0.9


def test_what_is_accepted_speaks_no_more():
    columns, left, block = next(null_draws(1, seed=4))
    blocks = Blocks.of(block, N_BLOCKS)
    strong = left + 5.0 * columns[:, 0]
    alone = score(columns, strong, blocks)
    fitted = strong - columns[:, 0] * (columns[:, 0] @ strong) / (
        columns[:, 0] @ columns[:, 0]
    )
    after = score(columns, fitted, blocks, columns[:, :1])
    assert abs(alone.t[0]) > 3.0
    assert after.t[0] == 0.0, "inside the accepted column only rounding is left"
    assert after.information[0] == 0.0
    twin = COLUMNS // 2
    assert abs(alone.t[twin]) > 3.0
    assert abs(after.t[twin]) < 3.0


@hypothesis.given(st.integers(0, 2**32 - 1), st.integers(1, 3))
@hypothesis.settings(max_examples=40, deadline=None)
def test_the_efficient_score_is_that_of_the_projected_column(seed, n_accepted):
    rng = np.random.default_rng(seed)
    block = np.sort(rng.integers(0, 7, size=200))
    blocks = Blocks.of(block, 7)
    columns, accepted = rng.normal(size=(200, 4)), rng.normal(size=(200, n_accepted))
    left = orthogonal(rng.normal(size=(200, 1)), accepted)[:, 0]
    efficient = orthogonal(columns, accepted)
    s, plain = score(columns, left, blocks, accepted), score(efficient, left, blocks)
    assert s.information == pytest.approx((efficient**2).sum(axis=0), rel=1e-6)
    assert s.size == pytest.approx(plain.size, rel=1e-6, abs=1e-9)
    assert s.gain == pytest.approx(plain.gain, rel=1e-6, abs=1e-9)


@hypothesis.given(st.integers(0, 2**32 - 1), st.floats(1e-3, 1e3))
@hypothesis.settings(max_examples=40, deadline=None)
def test_neither_unit_nor_sign_of_a_column_matters(seed, factor):
    rng = np.random.default_rng(seed)
    blocks = Blocks.of(np.repeat(np.arange(10), 20), 10)
    column, left = rng.normal(size=(200, 1)), rng.normal(size=200)
    one, other = score(column, left, blocks), score(-factor * column, left, blocks)
    assert other.t == pytest.approx(-one.t, rel=1e-9)
    assert other.gain == pytest.approx(one.gain, rel=1e-9)
    assert other.size * factor == pytest.approx(-one.size, rel=1e-9)


def test_blocks_keep_every_sample_once_in_any_order():
    rng = np.random.default_rng(5)
    block = rng.integers(0, 9, size=300)
    block[block == 4] = 3  # one of them is empty
    blocks = Blocks.of(block, 9)
    a, b = rng.normal(size=(300, 3)), rng.normal(size=(300, 2))
    products = blocks.products(a[blocks.order], b[blocks.order])
    assert sorted(blocks.order) == list(range(300))
    for k in range(9):
        assert products[k] == pytest.approx(a[block == k].T @ b[block == k], abs=1e-9)


def test_p_values_count_the_flips_that_reach_as_far():
    maxima = np.array([1.0, 2.0, 3.0, 4.0])
    assert adjusted(np.array([0.5, 2.0, -3.5, 9.0]), maxima) == pytest.approx(
        [1.0, 0.8, 0.4, 0.2]
    )
    assert critical(np.arange(1001.0), 0.01) == pytest.approx(990.0)
    assert SCREEN_LEVEL <= 0.01, "the family-wise error of a whole log"


@hypothesis.given(st.floats(0.1, 8.0), st.floats(2.0, 200.0))
def test_a_t_of_few_blocks_is_told_as_the_normal_deviation_of_equal_probability(
    z, freedom
):
    t = float(student(z, np.array(freedom)))
    assert normal(np.array(t), np.array(freedom)) == pytest.approx(z, rel=1e-6)
    assert normal(np.array(-t), np.array(freedom)) == pytest.approx(-z, rel=1e-6)
    exact = stats.norm.isf(stats.t.sf(t, freedom))
    assert z == pytest.approx(exact, rel=0.03 if freedom > 6.0 else 0.09)


def test_freedom_counts_the_blocks_that_a_direction_shows_in():
    even, single = np.ones((30, 1)), np.zeros((30, 1))
    single[4] = 7.0
    assert freedom_of(np.hstack([even, single])) == pytest.approx([29.0, 0.5])


def test_a_direction_that_shows_in_few_blocks_costs_the_others_no_power():
    rng = np.random.default_rng(8)
    block = np.repeat(np.arange(N_BLOCKS), PER_BLOCK)
    blocks = Blocks.of(block, N_BLOCKS)
    even = rng.normal(size=(len(block), 6))
    rare = np.where(block < 3, 30.0, 0.0)[:, None] * rng.normal(size=(len(block), 1))
    left = rng.normal(size=len(block)) + 2.0 * rare[:, 0] * np.where(
        block == 1, -1.0, 1.0
    )
    alone = critical(null_maxima([score(even, left, blocks)], np.random.default_rng(0)))
    both = critical(null_maxima([score(np.hstack([even, rare]), left, blocks)],
                                np.random.default_rng(0)))  # fmt: skip
    assert both < 1.5 * alone

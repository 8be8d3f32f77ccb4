"""Steps of a recorded quantity, told by its values; and smooth ones that have none."""

import numpy as np
import pytest

from hilserver.diagnosis.checks.comb import coarse_step, lattice


def seeds(quick, count):
    """Return that many seeds, of which the first few are tried in every run."""
    others = [
        pytest.param(seed, marks=pytest.mark.long) for seed in range(quick, count)
    ]
    return [*range(quick), *others]


def speeds(seed, n=20_000):
    """Return four wheels' true speeds [rpm]: dwells at round and odd set-points, and ramps."""
    rng = np.random.default_rng(seed)
    levels = np.concatenate([rng.uniform(-90, 90, 30), rng.integers(-9, 9, 10) * 10.0])
    true = np.repeat(rng.permutation(levels), n // 40)
    true = np.convolve(true, np.ones(50) / 50, mode="same")
    return [true + rng.normal(scale=0.05, size=n) for _ in range(4)], rng


@pytest.mark.parametrize("seed", seeds(2, 6))
@pytest.mark.parametrize("about", [0.4, 0.5, 1.0, 3.0])
def test_the_step_of_rounded_values_comes_out(about, seed):
    true, rng = speeds(seed)
    step = about * rng.uniform(1.0, 1.2)
    measured = [
        np.round(v / step) * step + rng.normal(scale=0.12, size=len(v)) for v in true
    ]
    assert coarse_step(measured, true) == pytest.approx(step, rel=1e-3)


@pytest.mark.parametrize("seed", seeds(3, 8))
@pytest.mark.parametrize("noise", [0.0, 0.02, 0.12])
def test_smooth_values_have_none(seed, noise):
    """Round set-points, and a recorder that keeps two decimals, are no steps of an encoder."""
    true, rng = speeds(seed)
    measured = [np.round(v + rng.normal(scale=noise, size=len(v)), 2) for v in true]
    assert coarse_step(measured, true) is None


@pytest.mark.parametrize("seed", seeds(3, 8))
def test_wheels_that_rest_at_few_speeds_have_none(seed):
    """A load keeps them from their set-points; of any few speeds some step is a divisor."""
    rng = np.random.default_rng(seed)
    setpoints = rng.choice([0.0, 62.0, 76.0, 90.0, -62.0, -90.0], size=60)
    wanted = np.repeat(setpoints, 300)
    reached = np.convolve(0.71 * wanted, np.ones(40) / 40, mode="same")
    measured = [reached + rng.normal(scale=0.12, size=len(wanted)) for _ in range(4)]
    assert coarse_step(measured, [wanted] * 4) is None


def test_the_lattice_tells_both_shares():
    rng = np.random.default_rng(1)
    true = rng.uniform(-90.0, 90.0, 50_000)
    noise = rng.normal(scale=0.1, size=len(true))
    faded = np.exp(-2.0 * np.pi**2 * 0.1**2 / 0.5**2)
    assert lattice(np.round(true / 0.5) * 0.5 + noise, true, 0.5) == pytest.approx(
        (faded, 0.0), abs=0.02
    )
    assert lattice(true + noise, true, 0.5) == pytest.approx((0.0, faded), abs=0.02)


def test_too_few_or_constant_values_have_none():
    assert coarse_step([np.zeros(5000)], [np.zeros(5000)]) is None
    assert coarse_step([np.arange(20.0)], [np.arange(20.0)]) is None
    assert coarse_step([], []) is None

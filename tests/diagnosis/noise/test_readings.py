"""Rounded and limited readings: their mean, their noise, and what of it lasts."""

import math

import numpy as np
import pytest

from hilserver.diagnosis.noise.readings import (
    FLOOR_SD,
    Reading,
    lasting,
    noise_of_readings,
)
from hilserver.diagnosis.noise.whitening import NoiseModel
from tests.diagnosis.toy import whitened

RNG = 5
PERIOD_S = 0.01


def read(exact, noise_sd, step, limit=math.inf, seed=RNG):
    """What a sensor makes of a quantity."""
    noisy = exact + noise_sd * np.random.default_rng(seed).normal(size=len(exact))
    rounded = step * np.round(noisy / step) if step else noisy
    return np.clip(rounded, -limit, limit)


def plateaus(n=60_000, lasts=80):
    """A quantity that rests at many places, as the speed of a loop does, and moves between."""
    rng = np.random.default_rng(6)
    levels = rng.uniform(-60.0, 60.0, n // lasts + 2)
    at = np.arange(n) / lasts
    share = np.clip((at % 1.0) * 5.0, 0.0, 1.0)
    low = levels[at.astype(int)]
    return low + share * (levels[at.astype(int) + 1] - low)


@pytest.mark.parametrize("step", [0.0, 0.1, 0.4, 1.0])
@pytest.mark.parametrize("beyond", [-3.0, -1.0, 0.0, 1.0, 4.0])
def test_the_mean_reading_at_a_limit_is_that_of_many(step, beyond):
    noise_sd, limit, n = 0.15, 100.0, 200_000
    exact = np.full(n, limit + (0.0 if step >= noise_sd else beyond * noise_sd))
    noise = NoiseModel(math.hypot(noise_sd, step / math.sqrt(12.0)))
    for side in (1.0, -1.0):
        mean = read(side * exact, noise_sd, step, limit).mean()
        said = Reading(step, 0.0, limit).mean(side * exact, noise)[0]
        assert said == pytest.approx(mean, abs=0.03 * noise_sd)


def test_without_noise_a_reading_at_the_limit_is_the_limit():
    exact = np.array([99.0, 100.0, 130.0])
    for noise in (None, NoiseModel(FLOOR_SD)):
        assert Reading(0.0, 0.0, 100.0).mean(exact, noise).tolist() == [
            99.0,
            100.0,
            100.0,
        ]


def test_far_from_a_limit_a_reading_is_the_quantity():
    exact = np.linspace(-90.0, 90.0, 1000)
    assert np.array_equal(Reading(0.4, 0.0, 100.0).mean(exact, NoiseModel(0.15)), exact)
    assert np.array_equal(Reading().mean(exact, NoiseModel(0.15)), exact)


@pytest.mark.parametrize("limit", [math.inf, 50.0, 50.17])
def test_the_step_is_told_whether_or_not_the_limit_is_one_of_them(limit):
    found = Reading.of(read(plateaus(), 0.1, 0.4, limit), limit)
    assert (found.step, found.limit) == (pytest.approx(0.4), limit)


@pytest.mark.parametrize("noise_sd", [0.03, 0.08, 0.15, 0.4])
@pytest.mark.parametrize("step", [0.05, 0.3, 1.0])
def test_the_noise_is_told_whatever_its_share_of_a_step(noise_sd, step):
    exact = plateaus()
    readings = read(exact, noise_sd, step)
    t_s = np.arange(len(exact)) * PERIOD_S
    noise = noise_of_readings([(t_s, exact, readings)], Reading(step))
    assert noise is not None
    assert noise.sd == pytest.approx(np.std(readings - exact), rel=0.05)
    assert noise.ou_sd**2 == pytest.approx(
        lasting(noise_sd, step), abs=0.25 * noise.sd**2
    )


def test_an_effect_is_no_noise():
    exact = plateaus()
    readings = read(exact + 0.8 * np.sin(np.arange(len(exact)) / 400.0), 0.08, 0.3)
    t_s = np.arange(len(exact)) * PERIOD_S
    noise = noise_of_readings([(t_s, exact, readings)], Reading(0.3))
    assert noise.sd == pytest.approx(math.hypot(0.08, 0.3 / math.sqrt(12.0)), rel=0.15)


def test_what_lasts_is_whitened():
    """Means over a second scatter no more than whitened samples do."""
    exact = plateaus()
    readings = read(exact, 0.03, 0.3)
    t_s = np.arange(len(exact)) * PERIOD_S
    noise = noise_of_readings([(t_s, exact, readings)], Reading(0.3))
    white = whitened(noise, t_s, readings - exact)
    plain = (readings - exact) / noise.sd
    spread = [
        len(r[0]) * np.var(r.mean(axis=1))
        for r in (white.reshape(-1, 100), plain.reshape(-1, 100))
    ]
    assert spread[1] > 10.0
    assert spread[0] < 2.5


def test_too_few_calm_samples_tell_nothing():
    exact = np.arange(40.0)
    assert noise_of_readings([(exact, exact, np.round(exact))], Reading(1.0)) is None

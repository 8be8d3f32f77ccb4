"""Each number that decides what is noise: a case on either side of it."""

import numpy as np
import pytest

from hilserver.diagnosis import thresholds as at
from hilserver.diagnosis.noise import quick_noise
from hilserver.diagnosis.noise.readings import Reading, noise_of_readings
from tests.diagnosis import toy

LESS, MORE = 0.9, 1.1
NONE = np.zeros((0, 3))
N = 2000


def outlier(deviations):
    return bool(quick_noise.isolated(np.array([0.0, deviations, 0.0])).any())


def outliers_in_a_row(number):
    white = np.zeros(40)
    white[10 : 10 + number] = 9.0
    return bool(quick_noise.isolated(white).any())


def plain(correlation=0.0, far_share=0.0, far_sd=20.0):
    rng = np.random.default_rng(6)
    n = 50_000
    steps = rng.normal(size=n)
    values = steps + correlation * np.roll(steps, 1)
    values[: round(far_share * n)] = far_sd
    if far_share:
        rng.shuffle(values)
    return quick_noise.plain_noise([(np.arange(n) * 0.02, values)]) is not None


def rounded_noise_known(samples):
    rng = np.random.default_rng(7)
    exact = np.zeros(round(samples) + 1)
    read = np.rint(rng.normal(size=len(exact)))
    reading = Reading(1.0, 0.0, np.inf)
    return (
        noise_of_readings([(np.arange(len(exact)) * 0.02, exact, read)], reading)
        is not None
    )


def calm(share):
    """A quantity that moves by a share of a step between two samples."""
    exact = share * np.arange(400.0)
    read = np.rint(exact + np.random.default_rng(8).normal(size=400))
    reading = Reading(1.0, 0.0, np.inf)
    return (
        noise_of_readings([(np.arange(400) * 0.02, exact, read)], reading) is not None
    )


def knows_correlation(length_s):
    problem = toy.problem(np.zeros(round(length_s / toy.PERIOD_S)), {})
    return not problem.is_short


@pytest.mark.parametrize(
    ("decides", "holds", "fails"),
    [
        pytest.param(outlier, MORE * at.OUTLIER_SD, LESS * at.OUTLIER_SD, id="OUTLIER_SD"),
        pytest.param(
            outliers_in_a_row, at.OUTLIERS_IN_A_ROW, at.OUTLIERS_IN_A_ROW + 1,
            id="OUTLIERS_IN_A_ROW",
        ),
        pytest.param(plain, 0.5 * at.NOISE_WHITE, 1.5 * at.NOISE_WHITE, id="NOISE_WHITE"),
        pytest.param(
            lambda share: plain(far_share=share), 0.5 * at.NOISE_FEW_FAR, 1.5 * at.NOISE_FEW_FAR,
            id="NOISE_FEW_FAR",
        ),
        pytest.param(
            lambda sd: plain(far_share=0.004, far_sd=sd), LESS * at.FAR_SD, MORE * at.FAR_SD,
            id="FAR_SD of noise",
        ),
        pytest.param(
            rounded_noise_known, at.FEWEST_SAMPLES, at.FEWEST_SAMPLES - 1, id="FEWEST_SAMPLES"
        ),
        pytest.param(calm, LESS * at.READING_CALM, MORE * at.READING_CALM, id="READING_CALM"),
        pytest.param(
            knows_correlation, MORE * at.NOISE_TAU_MAX_S, LESS * at.NOISE_TAU_MAX_S,
            id="NOISE_TAU_MAX_S",
        ),
    ],
)  # fmt: skip
def test_noise_ends_at_its_number(decides, holds, fails):
    assert decides(holds)
    assert not decides(fails)


def test_steps_far_finer_than_the_noise_are_not_its_measure():
    exact, rng = np.zeros(N), np.random.default_rng(4)
    read = np.rint(1e3 * rng.normal(size=N))
    parts = [(np.arange(N) * 0.02, exact, read)]
    assert noise_of_readings(parts, Reading(1.0, 0.0, np.inf)) is None

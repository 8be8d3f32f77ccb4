"""Least squares on columns whose lengths differ by many orders of magnitude."""

import numpy as np
import pytest

from hilserver.diagnosis.regression import linear

LENGTHS = np.array([1e-60, 1.0, 1e40])


@pytest.fixture
def columns(rng):
    return rng.normal(size=(400, 3)) * LENGTHS


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def test_coefficients_come_back_whatever_the_units(columns):
    truth = np.array([3.0, -2.0, 0.5]) / LENGTHS
    assert linear.ridge(columns, columns @ truth) == pytest.approx(truth, rel=1e-7)


def test_a_column_that_shows_nowhere_gets_nothing_and_takes_nothing(columns, rng):
    columns[:, 1] = 0.0
    target = rng.normal(size=400)
    assert linear.ridge(columns, target)[1] == 0.0
    assert linear.saved(columns, target, 1e-6) == pytest.approx(
        linear.saved(columns[:, [0, 2]], target, 1e-6)
    )
    assert linear.inverse_gram(columns)[1, 1] > 1e100
    assert linear.cosine(columns[:, 1], target) == 0.0


def test_what_is_saved_is_what_the_projection_takes(columns, rng):
    target = rng.normal(size=400)
    left = linear.orthogonal(target, columns)
    assert np.abs(columns.T @ left / LENGTHS).max() < 1e-10
    assert linear.saved(columns, target, 1e-12) == pytest.approx(
        target @ target - left @ left
    )
    assert linear.orthogonal(target, None) is target
    assert linear.basis(columns[:, :0]).shape == (400, 0)


def test_the_covariance_is_that_of_white_noise_or_of_blocks_that_scatter_more(
    columns, rng
):
    noise = rng.normal(size=400)
    block = np.repeat(np.arange(40), 10)

    def of(left):
        sums = np.stack(
            [np.bincount(block, columns[:, j] * left) for j in range(3)], axis=1
        )
        return np.diag(linear.covariance(columns, sums, 40, float(np.mean(left**2))))

    white = np.diag(linear.inverse_gram(columns))
    assert (of(0.01 * noise) / white).tolist() == pytest.approx([1.0] * 3)
    drawn = np.array([of(rng.normal(size=400)) / white for _ in range(50)]).mean(axis=0)
    assert drawn.tolist() == pytest.approx([1.1] * 3, abs=0.2)
    alike = np.sign(columns[:, 1]) * np.repeat(rng.normal(size=40), 10)
    assert of(alike)[1] / white[1] > 4.0


def test_a_fit_that_leaves_nothing_is_as_sure_as_the_noise_model(columns):
    left = linear.covariance(columns, np.zeros((40, 3)), 40, 0.0)
    assert np.sqrt(np.diag(left)) * LENGTHS == pytest.approx(np.full(3, 0.05), rel=0.2)

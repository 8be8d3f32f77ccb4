"""Shared and free parameters of groups whose truth is known."""

import numpy as np
import pytest

from hilserver.diagnosis.groups.sharing import GroupFit, free_parameters, together

K = 4
UNITS = [(i,) for i in range(K)]
NO_LEAST = np.zeros(K)
LEVEL = 0.01


def groups(rng, values, *, blocks=60, logs=None):
    """Estimates of groups, each with a covariance that is itself estimated."""
    fits = []
    for value in values:
        columns = rng.normal(size=(blocks, K))
        columns[:, 1] += columns[:, 0]
        known = np.linalg.inv(columns.T @ columns)
        own = np.cov(rng.multivariate_normal(np.zeros(K), known, size=blocks + 1).T)
        drawn = rng.multivariate_normal(np.asarray(value, float), known)
        fits.append(
            GroupFit(drawn, np.ones(K, bool), own, np.full(K, float(logs or blocks)))
        )
    return fits


def freed(fits, **options):
    return free_parameters(
        fits, UNITS, options.pop("least", NO_LEAST), LEVEL, **options
    )


def test_what_is_equal_is_shared_and_known_better():
    rng, truth = np.random.default_rng(0), [1.0, -2.0, 0.5, 3.0]
    wrong = sum(freed(groups(rng, [truth] * 3)).any() for _ in range(60))
    assert wrong <= 3, "1 % in the long run"
    fits = groups(rng, [truth] * 3)
    whole = together(fits, np.zeros(K, bool))
    assert whole.value[0] == pytest.approx(whole.value[2])
    alone = np.mean([np.diag(f.covariance) for f in fits], axis=0)
    assert np.diag(whole.covariance[1]) == pytest.approx(alone / 3.0, rel=0.5)
    assert whole.value[0] == pytest.approx(truth, abs=0.5)


def test_what_differs_is_free_and_only_that():
    rng = np.random.default_rng(1)
    truth = np.array([[1.0, -2.0, 0.5, 3.0], [2.5, -2.0, 0.5, 3.0]])
    found = [freed(groups(rng, truth)) for _ in range(20)]
    right = sum((free == [True, False, False, False]).all() for free in found)
    assert right >= 18
    fits = groups(rng, truth)
    whole = together(fits, np.array([True, False, False, False]))
    assert whole.value[:, 0] == pytest.approx(truth[:, 0], abs=0.6)
    assert whole.value[0, 1:] == pytest.approx(whole.value[1, 1:])
    assert whole.unknowns.shape == (K + 1, K + 1)


def test_a_difference_below_the_least_is_none():
    rng = np.random.default_rng(2)
    fits = groups(rng, [[1.0, 0, 0, 0], [2.5, 0, 0, 0]])
    assert freed(fits)[0]
    assert not freed(fits, least=np.full(K, 5.0)).any()


def test_what_one_group_does_not_show_is_judged_by_the_others():
    rng = np.random.default_rng(3)
    first, second, third = groups(rng, [[1.0, 0, 0, 0], [2.5, 0, 0, 0], [9e9, 0, 0, 0]])
    blind = GroupFit(
        third.value, np.array([False, True, True, True]), third.covariance, third.dof
    )
    free = freed([first, second, blind])
    assert free.tolist() == [True, False, False, False]
    whole = together([first, second, blind], free)
    assert whole.value[2, 0] == pytest.approx(whole.value[:2, 0].mean())
    assert not freed([first, blind])[0], "there is nothing to compare it with"


def test_parts_of_one_wave_are_free_together():
    rng = np.random.default_rng(4)
    fits = groups(rng, [[1.0, 0, 0, 0], [3.0, 0, 0, 0]])
    free = free_parameters(fits, [(0, 1), (2,), (3,)], NO_LEAST, LEVEL)
    assert free.tolist() == [True, True, False, False]


def test_units_that_differ_by_orders_of_magnitude_do_no_harm():
    rng = np.random.default_rng(5)
    scale = np.array([1e-6, 1e6, 1.0, 1e3])
    fits = groups(rng, [[1.0, -2.0, 0.5, 3.0]] * 2)
    large = [
        GroupFit(f.value * scale, f.known, f.covariance * np.outer(scale, scale), f.dof)
        for f in fits
    ]
    plain, scaled = (together(some, np.zeros(K, bool)) for some in (fits, large))
    assert scaled.value[0] / scale == pytest.approx(plain.value[0])
    assert scaled.misfit == pytest.approx(plain.misfit)

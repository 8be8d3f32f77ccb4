"""The noise of a log by its own innovations: what it was, and what a filter gains by it."""

import numpy as np
import pytest

from hilserver.observer.layout import FilterFigures
from hilserver.observer.log_noise import fitted, inflated, sd_of
from hilserver.observer.offline import GYRO, MeasuredSeries, misfit, run
from tests.observer.rig import Observed, drive, robot
from tests.observer.test_smoother import series

N = 1500


def made_wrong(observed, **factors):
    c = observed.c.copy()
    for name, factor in factors.items():
        FilterFigures.of(c)[name] *= factor
    return c


def test_noise_that_was_given_wrongly_is_found():
    observed = Observed(robot(), unknown={})
    s = series(drive(observed.p, observed.figures, N))
    wrong = made_wrong(observed, position_sd=8.0, position_ou=0.2, gyro_sd=5.0)
    found = fitted(observed.p, wrong, [s])
    for name in ("position_sd", "position_ou", "gyro_sd"):
        assert sd_of(found, name) / sd_of(observed.c, name) == pytest.approx(
            1.0, rel=0.5
        )
    assert misfit(observed.p, found, s) < misfit(observed.p, observed.c, s) + 100.0


def test_noise_that_was_given_rightly_stays():
    observed = Observed(robot(), unknown={})
    s = series(drive(observed.p, observed.figures, N))
    found = fitted(observed.p, observed.c, [s])
    for name in ("position_ou", "yaw_ou", "gyro_sd"):
        assert sd_of(found, name) / sd_of(observed.c, name) == pytest.approx(
            1.0, rel=0.5
        )
    assert sd_of(found, "slip_sd") < 0.01


def test_a_filter_of_a_strange_robot_stays_near_it():
    """The wheels are a third larger than thought, and the navigation is better."""
    observed, strange = Observed(robot()), Observed(robot(wheel_radius=0.3))
    strange.figures.position_ou = strange.figures.yaw_ou = 0.0
    d = drive(strange.p, strange.figures, N)
    s, errors = series(d, cut=(800, 1200)), []
    for c in (observed.c, fitted(observed.p, observed.c, [s])):
        x = run(observed.p, c, s).estimate[100:]
        errors.append(np.sqrt(np.mean((x[:, :2] - d.truth[100:, :2]) ** 2)))
    assert errors[1] < 0.3 * errors[0]


def test_outliers_do_not_make_all_samples_noisy():
    observed = Observed(robot(), unknown={})
    d = drive(observed.p, observed.figures, N)
    d.position[100::250] += np.random.default_rng(3).uniform(-5.0, 5.0, (6, 2))
    found = fitted(observed.p, observed.c, [series(d)])
    assert sd_of(found, "position_sd") < 0.05


def test_without_navigation_nothing_can_be_fitted():
    observed = Observed(robot())
    s = series(drive(observed.p, observed.figures, 50))
    alone = MeasuredSeries(s.wheels, s.samples[s.samples[:, 0] == GYRO])
    assert fitted(observed.p, observed.c, [alone]) is observed.c


def test_inflated_noise_gives_the_same_path_less_certainly():
    observed = Observed(robot())
    s = series(drive(observed.p, observed.figures, 300))
    less, more = (
        run(observed.p, c, s) for c in (observed.c, inflated(observed.c, 4.0))
    )
    np.testing.assert_allclose(more.estimate[100:], less.estimate[100:], atol=1e-3)
    grown = more.covariance[-1] / less.covariance[-1]
    np.testing.assert_allclose(np.diag(grown), 4.0, rtol=0.02)

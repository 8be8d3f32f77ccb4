"""Model, fit, intervals and gain on a regression whose truth is known."""

import numpy as np
import pytest

from hilserver.diagnosis.catalogue.library import drive_candidates
from hilserver.diagnosis.catalogue.traits import Traits
from hilserver.diagnosis.catalogue.vocabulary import OF_THE_LOG
from hilserver.diagnosis.noise.quick_noise import isolated
from hilserver.diagnosis.regression import intervals as of_intervals
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.regression.gain import Errors, compare, crossed, held_out
from hilserver.diagnosis.regression.intervals import (
    covariance,
    limits,
    whole_covariance,
)
from hilserver.diagnosis.replay.model import Fitted, Model, robot_with
from hilserver.plant.packing import pack
from hilserver.plant.parameters import RobotParameters
from tests.diagnosis import toy
from tests.diagnosis.assertions import no_prediction_saw_its_block

N = 2400


def intervals(problem, point):
    return limits(point.model.theta(), *whole_covariance(problem, point))


def columns_of(rng, n_columns=2, n=N):
    return {f"c{k}": 30.0 * toy.smooth(rng, n) for k in range(n_columns)}


def drawn(seed, *, tau_s=None, n_columns=2, theta=(0.7, -1.2), noise_sd=1.0):
    """A regression with known parameters; its noise may be correlated, which nobody is told."""
    rng = np.random.default_rng(seed)
    columns = columns_of(rng, n_columns)
    noise = (
        rng.normal(size=N) if tau_s is None else toy.ornstein_uhlenbeck(rng, N, tau_s)
    )
    signal = sum(t * c for t, c in zip(theta, columns.values(), strict=False))
    return toy.problem(signal + noise_sd * noise, columns)


def fitted(problem, *names, rows=None):
    model = toy.model(*names)
    return fit(problem, model, problem.point(Model(), np.zeros((0, 3))), rows=rows)


def test_a_fit_finds_least_squares():
    problem = drawn(1)
    point = fitted(problem, "c0", "c1")
    design = np.stack(list(problem.stage.columns.values()), axis=1)
    best, *_ = np.linalg.lstsq(design, problem.stack.values, rcond=None)
    assert point.model.theta() == pytest.approx(best, rel=1e-4)
    rest = problem.stack.values - design @ best
    assert point.deviance == pytest.approx(rest @ rest, rel=1e-6)
    assert point.loss.sum() == pytest.approx(point.deviance)


def test_rows_that_do_not_count_change_nothing():
    problem = drawn(2)
    train = problem.stack.fold == 0
    values = problem.stack.values.copy()
    first = fitted(problem, "c0", rows=train).model.theta()
    values[~train[problem.stack.block]] += 100.0
    spoilt = toy.problem(values, problem.stage.columns)
    assert fitted(spoilt, "c0", rows=train).model.theta() == pytest.approx(
        first, abs=1e-9
    )
    assert fitted(spoilt, "c0").model.theta() != pytest.approx(first, abs=1e-2)


@pytest.mark.parametrize("tau_s", [None, 0.15])
def test_the_intervals_hold_the_truth_even_if_the_noise_is_not_what_it_is_said_to_be(
    tau_s,
):
    theta, held = (0.02, -0.03), []
    for seed in range(150):
        problem = drawn(seed, tau_s=tau_s, theta=theta)
        limits = intervals(problem, fitted(problem, "c0", "c1"))
        held += [
            low <= true <= high for (low, high), true in zip(limits, theta, strict=True)
        ]
    assert 0.90 <= np.mean(held) <= 0.995, f"{np.mean(held):.1%} of {len(held)}"


def test_more_data_and_stronger_columns_make_intervals_narrower():
    problem = drawn(3)
    wide = np.ptp(intervals(problem, fitted(problem, "c0", "c1")), axis=1)
    strong = toy.problem(
        problem.stack.values, {k: 4.0 * c for k, c in problem.stage.columns.items()}
    )
    narrow = np.ptp(intervals(strong, fitted(strong, "c0", "c1")), axis=1)
    assert narrow == pytest.approx(wide / 4.0, rel=1e-3)


def test_what_acts_in_whole_ticks_is_known_no_better_than_its_rounding(monkeypatch):
    problem = drawn(3)
    point = fitted(problem, "c0", "c1")
    wide = np.ptp(intervals(problem, point), axis=1)
    monkeypatch.setattr(
        of_intervals, "traits_of", lambda cause: Traits(whole_ticks=cause == "c0")
    )
    monkeypatch.setattr(of_intervals, "ROUNDED", 0.5 / problem.stage.robot.period_s)
    rounded = np.ptp(intervals(problem, point), axis=1)
    assert rounded[0] > 1.9 > wide[0]
    assert rounded[1] == pytest.approx(wide[1])


@pytest.mark.parametrize("n", [200, 600])
def test_away_from_the_fit_to_all_samples_an_interval_reaches_there_in_short_segments(
    n,
):
    """There parameters are halfway to another fit; elsewhere they are where all samples say."""
    rng = np.random.default_rng(6)
    columns = columns_of(rng, n=n)
    problem = toy.problem(
        sum(columns.values()) + rng.normal(size=n), columns, block_s=0.1
    )
    at = fitted(problem, "c0", "c1")
    sd = np.ptp(intervals(problem, at), axis=1) / 4.0
    away = at.model.with_theta(at.model.theta() + 10.0 * sd * [1.0, 0.0])
    moved = intervals(problem, problem.point(away, at.poses))
    assert problem.is_short == (n == 200)
    assert (moved[0, 0] < at.model.theta()[0]) == problem.is_short


def test_away_from_the_fit_to_all_samples_parameters_are_no_more_alike():
    rng = np.random.default_rng(6)
    columns = columns_of(rng, n=200)
    problem = toy.problem(
        sum(columns.values()) + rng.normal(size=200), columns, block_s=0.1
    )
    at = fitted(problem, "c0", "c1")
    there = problem.point(at.model.with_theta(at.model.theta() + 5.0), at.poses)
    whole, _ = whole_covariance(problem, there)
    own, _ = covariance(problem, there, problem.accepted(there))
    assert problem.is_short
    assert whole[0, 1] == own[0, 1]
    assert np.all(np.diag(whole) > np.diag(own) + 4.0**2)


def test_the_covariance_is_never_smaller_than_the_noise_model_says():
    problem = drawn(4, noise_sd=0.3)  # told: 1
    point = fitted(problem, "c0", "c1")
    design = np.stack(list(problem.stage.columns.values()), axis=1)
    naive = np.diag(np.linalg.inv(design.T @ design))
    assert np.all(
        np.diag(covariance(problem, point, problem.accepted(point))[0])
        >= naive * (1.0 - 1e-6)
    )


# --- gain -----------------------------------------------------------------------------------------


def spoil(problem, rows):
    values = problem.stack.values.copy()
    values[rows] += 20.0 * np.random.default_rng(9).normal(size=int(rows.sum()))
    return toy.problem(values, problem.stage.columns)


def test_a_block_is_predicted_by_a_fit_that_did_not_see_it():
    no_prediction_saw_its_block(drawn(5), toy.model("c0", "c1"), spoil)


def test_causes_that_are_none_gain_nothing_on_held_out_blocks():
    ratios = []
    for seed in range(8):
        problem = drawn(seed, n_columns=40, theta=())
        start = problem.point(Model(), np.zeros((0, 3)))
        model = toy.model(*problem.stage.columns)
        predicted = held_out(problem, crossed(problem, start, model))
        before, after = problem.residual(start.predicted), problem.residual(predicted)
        ratios.append(np.abs(before).mean() / np.abs(after).mean())
    assert np.mean(ratios) < 1.0, "forty columns of noise seem to help"


def errors(rng, level, block):
    return Errors(level * np.abs(rng.normal(size=len(block))), block)


def test_the_ratio_is_one_of_means_and_its_interval_counts_blocks():
    rng = np.random.default_rng(6)
    block = np.repeat(np.arange(30), 40)
    gain = compare(errors(rng, 2.0, block), errors(rng, 0.5, block), 5.0, rng)
    assert gain.ratio == pytest.approx(gain.before / gain.after)
    assert gain.horizon_s == 5.0
    low, high = gain.ci95
    assert 3.5 < low < gain.ratio < high < 4.5
    # a level of its own for each block: as many samples, less to know
    uneven = np.repeat(rng.uniform(0.2, 3.0, size=30), 40)
    first, second = errors(rng, 2.0, block), errors(rng, 0.5, block)
    wide = compare(Errors(first.values * uneven, block), second, 5.0, rng).ci95
    assert wide[1] - wide[0] > 2.0 * (high - low)


def test_the_intervals_of_ratios_hold_the_truth():
    held = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        block = np.repeat(np.arange(24), 10)
        level = np.repeat(rng.gamma(4.0, 0.25, size=24), 10)
        before = Errors(level * 3.0 * rng.gamma(2.0, 0.5, size=240), block)
        after = Errors(level * rng.gamma(2.0, 0.5, size=240), block)
        low, high = compare(before, after, 1.0, rng).ci95
        held.append(low <= 3.0 <= high)
    assert np.mean(held) > 0.89, f"{np.mean(held):.1%}"


def test_the_intervals_of_ratios_hold_the_truth_where_neighbours_are_alike():
    """Free runs overlap, and a floor or a heading lasts; drawn one by one, 67 % held the truth."""
    held, widths = [], []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        block, truth = np.arange(80), 3.0 * np.exp(0.125 - 0.08)
        before, after = (
            Errors(
                np.exp(sd * toy.ornstein_uhlenbeck(rng, 80, 2.0 * toy.PERIOD_S)), block
            )
            for sd in (0.5, 0.4)
        )
        more = Errors(3.0 * before.values, block)
        low, high = compare(more, after, 1.0, rng).ci95
        held.append(low <= truth <= high)
        widths.append(high / low)
    assert np.mean(held) > 0.8, f"{np.mean(held):.1%}"
    assert np.median(widths) < 1.8


def test_three_blocks_are_too_few_for_an_interval():
    rng = np.random.default_rng(7)
    block = np.repeat(np.arange(3), 10)
    assert (
        compare(errors(rng, 2.0, block), errors(rng, 1.0, block), 5.0, rng).ci95 is None
    )


# --- model ----------------------------------------------------------------------------------------


def test_a_model_adds_replaces_and_drops_causes():
    a, b, c = (toy.candidate(name) for name in "abc")
    model = Model().plus(a, (1.0,)).plus(b, (2.0,))
    assert model.terms == {"a": 1.0, "b": 2.0}
    assert model.causes == ("a", "b")
    assert model.with_theta(np.array([3.0, 4.0])).terms == {"a": 3.0, "b": 4.0}
    assert model.swapped(0, c, (5.0,)).terms == {"c": 5.0, "b": 2.0}
    assert model.without(0).fitted == (Fitted(b, (2.0,)),)
    assert Model().theta().shape == (0,)


def test_the_terms_of_a_model_stand_beside_those_of_the_plant():
    robot = RobotParameters(terms={"gyro_bias": 0.01})
    both = robot_with(robot, {"rotation_gain": 0.1})
    assert both.terms == {"gyro_bias": 0.01, "rotation_gain": 0.1}
    assert robot.terms == {"gyro_bias": 0.01}


def test_no_effect_is_no_change_of_the_plant():
    base = pack(RobotParameters())
    for candidate in drive_candidates():
        terms = candidate.terms(candidate.null)
        if (
            candidate.linear
            and len(terms) == 1
            and not terms.keys() & OF_THE_LOG.keys()
        ):
            assert np.array_equal(pack(robot_with(RobotParameters(), terms)), base), (
                candidate
            )


def test_only_few_far_samples_in_a_row_are_outliers():
    white = np.zeros(40)
    white[[3, 10, 11, 12, 13]] = -9.0
    white[20:30] = 9.0
    assert np.flatnonzero(isolated(white)).tolist() == [3, 10, 11, 12, 13]
    assert not isolated(np.full(5, 5.9)).any()

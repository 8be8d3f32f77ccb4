"""All parameters with one covariance, and what each cause matters."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hilserver.diagnosis.catalogue.candidate import wave
from hilserver.diagnosis.findings.estimate import StageEstimate, estimate_of, joint
from hilserver.diagnosis.findings.outcome import parameters
from hilserver.diagnosis.findings.sensors import noise_of
from hilserver.diagnosis.findings.worth import Explained, MemberStage, StageAnswer
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.regression.gain import crossed, held_out
from hilserver.diagnosis.replay.model import Model
from tests.diagnosis import sample, toy

N = 2400


def fitted(problem, *names):
    return fit(problem, toy.model(*names), problem.point(Model(), np.zeros((0, 3))))


@pytest.fixture(scope="module")
def alike():
    """Two causes whose columns are nearly the same, and one that is like neither."""
    rng = np.random.default_rng(4)
    a, aside, c = (30.0 * toy.smooth(rng, N) for _ in range(3))
    columns = {"a": a, "b": a + 0.1 * aside, "c": c}
    values = 0.5 * columns["a"] + 0.5 * columns["b"] - 0.8 * c + rng.normal(size=N)
    problem = toy.problem(values, columns)
    return problem, fitted(problem, "a", "b", "c")


def test_one_covariance_says_what_the_intervals_say(alike):
    problem, point = alike
    found = joint([estimate_of(problem, point)])
    assert found.parameters == ("a", "b", "c")
    assert found.value == pytest.approx(point.model.theta())
    shown = parameters(problem, point)
    half = [
        np.ptp(shown[i][name].ci95) / 2.0 for i, name in enumerate(found.parameters)
    ]
    deviation = np.sqrt(np.diag(found.covariance))
    assert half == pytest.approx(deviation * (half[0] / deviation[0]))
    assert 1.9 < half[0] / deviation[0] < 2.2
    assert found.covariance[0][1] / (deviation[0] * deviation[1]) < -0.9


def test_stages_are_fitted_apart(alike):
    problem, point = alike
    nothing = problem.point(Model(), point.poses)
    one, none = estimate_of(problem, point), estimate_of(problem, nothing)
    both = joint([one, none, one])
    assert len(both.parameters) == 6
    assert np.array(both.covariance)[:3, 3:] == pytest.approx(0.0)
    assert joint([none]) is None


def test_what_the_data_leave_open_is_as_wide_as_the_prior(alike):
    _, point = alike
    known = [
        replace(f, candidate=replace(f.candidate, prior=0.05))
        for f in point.model.fitted
    ]
    wide = StageEstimate.of(Model(tuple(known)), np.diag([1e9, 1e-8, 0.0025]))
    assert np.sqrt(np.diag(wide.covariance)) == pytest.approx(
        [0.05, 1e-4, 0.05 / np.sqrt(2.0)], rel=1e-3
    )


def test_a_wave_is_reported_as_amplitude_and_phase():
    rng = np.random.default_rng(0)
    names = ("heading_distortion.a1", "heading_distortion.phase1")
    candidate = wave("heading_distortion", "h", *names, 0.005)
    theta, known = np.array([0.06, 0.08]), np.array([[4e-6, 1e-6], [1e-6, 2e-6]])
    found = StageEstimate.of(Model().plus(candidate, tuple(theta)), known)
    assert found.names == names
    drawn = rng.multivariate_normal(theta, known, size=40_000)
    polar = np.stack([np.hypot(*drawn.T), np.arctan2(drawn[:, 1], drawn[:, 0])])
    assert found.value == pytest.approx(polar.mean(axis=1), rel=1e-2)
    assert found.covariance == pytest.approx(np.cov(polar), rel=0.05, abs=2e-7)


def test_partners_take_over_what_one_cause_explains_alone(alike):
    problem, point = alike
    estimate = estimate_of(problem, point)
    assert [estimate.partners(i) for i in range(3)] == [{1}, {0}, frozenset()]
    after = held_out(problem, crossed(problem, point, point.model))

    def without(causes):
        start = problem.point(point.model.without(*causes), point.poses)
        return (held_out(problem, crossed(problem, start, start.model)),)

    judged = SimpleNamespace(prepared=SimpleNamespace(problem=problem))
    whole = Explained(
        (MemberStage("", judged, np.zeros(N), np.zeros(N), after),), without
    )
    findings = (sample.findings().findings[0],) * 3
    answer = StageAnswer(whole, whole, point.model, findings, estimate)
    found = answer.with_worth(5.0, np.random.default_rng(0))
    one, _, alone = (item.matters[toy.SIGNAL] for item in found)
    assert one.alone == pytest.approx(1.0, abs=0.05)
    assert one.with_partners > 2.0
    assert alone.alone > 2.0
    assert alone.with_partners == alone.alone


def test_noise_tells_step_and_limits():
    problem = toy.problem(np.round(np.random.default_rng(0).normal(size=N) * 20.0), {})
    noise = noise_of(problem)[toy.SIGNAL]
    assert noise.step == pytest.approx(1.0)
    assert (noise.limits, noise.ou_tau_s, noise.tail_dof) == (None, None, None)

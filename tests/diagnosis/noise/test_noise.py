import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilserver.diagnosis.noise.fitting import fit_noise, robust_weights, short_noise
from hilserver.diagnosis.noise.whitening import Filter, NoiseModel
from hilserver.diagnosis.thresholds import SHORT_DOF
from tests.diagnosis import toy
from tests.diagnosis.toy import whitened
from tests.diagnosis.uwb_trolley import range_errors

NAVIGATION = NoiseModel(0.01, 0.05, 0.6)
MODELS = [
    pytest.param(NAVIGATION, id="position"),
    pytest.param(NoiseModel(0.0, 0.015, 2.0), id="coloured only"),
    pytest.param(NoiseModel(0.006), id="white only"),
]


def simulated(model, t_s, rng):
    """Draw the noise from its covariance's definition, sample by sample."""
    level, out = rng.normal() * model.ou_sd, np.empty(len(t_s))
    for i, step in enumerate(np.diff(t_s, prepend=t_s[0])):
        keep = math.exp(-step / model.ou_tau_s)
        level = keep * level + model.ou_sd * math.sqrt(1.0 - keep**2) * rng.normal()
        out[i] = level + model.white_sd * rng.normal()
    return out


def stamps(n, step_s, rng):
    """Jittered stamps with a fifth of the samples missing."""
    t_s = (np.arange(n) + rng.uniform(-0.4, 0.4, n)) * step_s
    return t_s[rng.random(n) > 0.2]


def covariance(model, t_s):
    apart = np.abs(t_s[:, None] - t_s[None, :])
    coloured = model.ou_sd**2 * np.exp(-apart / model.ou_tau_s)
    return coloured + model.white_sd**2 * np.eye(len(t_s))


@pytest.mark.parametrize("model", MODELS)
def test_whitened_noise_is_white(model):
    lags = 20
    rng = np.random.default_rng(3)
    t_s = stamps(6000, 0.05, rng)
    white = whitened(model, t_s, simulated(model, t_s, rng))
    n = len(white)
    assert white.var() == pytest.approx(1.0, abs=4.0 * math.sqrt(2.0 / n))
    rho = np.array([white[:-k] @ white[k:] for k in range(1, lags + 1)]) / (
        white @ white
    )
    ljung_box = n * (n + 2) * np.sum(rho**2 / (n - np.arange(1, lags + 1)))
    assert ljung_box < 45.3  # 99.9 % of chi-square with 20 degrees of freedom


@pytest.mark.parametrize("model", MODELS)
def test_operator_is_the_inverse_root_of_the_covariance(model):
    t_s = stamps(60, 0.05, np.random.default_rng(4))
    operator = whitened(model, t_s, np.eye(len(t_s)))
    expected = covariance(model, t_s)
    np.testing.assert_allclose(
        operator.T @ operator @ expected, np.eye(len(t_s)), atol=1e-7
    )


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("spoilt", [1e6, np.nan])
def test_skipped_samples_leave_no_trace(model, spoilt):
    rng = np.random.default_rng(5)
    t_s = stamps(200, 0.05, rng)
    r, kept = rng.normal(size=len(t_s)), rng.random(len(t_s)) > 0.3
    white = whitened(model, t_s, np.where(kept, r, spoilt), kept.astype(float))
    assert (white[~kept] == 0.0).all()
    alone = whitened(model, t_s[kept], r[kept])
    np.testing.assert_allclose(white[kept], alone, rtol=1e-9)


def test_stretches_of_several_channels_are_whitened_each_by_itself():
    rng = np.random.default_rng(6)
    t_s, weights = rng.random(90).cumsum(), rng.uniform(0.0, 2.0, 90)
    columns, parts = (
        rng.normal(size=(90, 3)),
        [slice(0, 40), slice(40, 60), slice(60, 90)],
    )
    every, models = Filter.empty(90), [NAVIGATION, NoiseModel(0.006), NAVIGATION]
    for model, part in zip(models, parts, strict=True):
        every.prepare(part, model, t_s, weights)
    white = every.whiten(columns)
    for model, part in zip(models, parts, strict=True):
        alone = whitened(model, t_s[part], columns[part], weights[part])
        np.testing.assert_array_equal(white[part], alone)


@settings(max_examples=30, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.floats(-1e3, 1e3),
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
    st.floats(0.01, 5.0),
)
def test_linear_in_the_columns(seed, factor, white_sd, ou_sd, tau_s):
    rng = np.random.default_rng(seed)
    t_s = stamps(80, 0.05, rng)
    weights = rng.uniform(0.0, 2.0, len(t_s)) * (rng.random(len(t_s)) > 0.1)
    model = NoiseModel(white_sd + 1e-3, ou_sd, tau_s)
    a, b = rng.normal(size=(2, len(t_s)))
    both = whitened(model, t_s, np.stack([a, b, a + factor * b], axis=1), weights)
    np.testing.assert_array_equal(both[:, 0], whitened(model, t_s, a, weights))
    scale = np.abs(both).max() + 1e-30
    error = both[:, 2] - both[:, 0] - factor * both[:, 1]
    assert np.abs(error).max() <= 1e-12 * scale * (1.0 + abs(factor))


def test_weights_keep_the_variance_and_bound_an_outlier():
    z = np.random.default_rng(6).standard_t(SHORT_DOF, 400_000) * math.sqrt(
        1.0 - 2.0 / SHORT_DOF
    )
    weights = robust_weights(z)
    assert np.mean(weights * z**2) == pytest.approx(1.0, abs=0.02)
    assert math.sqrt(robust_weights(np.array([1e6]))[0]) * 1e6 <= math.sqrt(
        SHORT_DOF + 1.0
    )


def test_nothing_to_whiten_with_is_refused():
    with pytest.raises(ValueError, match="no noise"):
        whitened(NoiseModel(0.0), np.arange(3.0), np.ones(3))


@pytest.mark.parametrize("wrong", ["clean", "outliers", "drift"])
@pytest.mark.parametrize("irregular", [False, True])
def test_position_noise_is_recovered(wrong, irregular):
    rng = np.random.default_rng(7)
    spans = []
    for _ in range(6):
        t_s = stamps(1500, 0.05, rng) if irregular else np.arange(1200) * 0.05
        r = simulated(NAVIGATION, t_s, rng)
        if wrong == "outliers":
            r += 1.5 * rng.choice([-1.0, 1.0], len(r)) * (rng.random(len(r)) < 0.03)
        if wrong == "drift":
            r += 0.15 * np.sin(2.0 * np.pi * t_s / 40.0)
        spans.append((t_s, r))
    found = fit_noise(spans)
    assert found.white_sd == pytest.approx(0.01, rel=0.12)
    assert found.ou_sd == pytest.approx(0.05, rel=0.12)
    assert found.ou_tau_s == pytest.approx(0.6, rel=0.25)
    assert found.tail_dof > 8.0


@pytest.mark.parametrize("wrong", ["clean", "outliers"])
def test_white_noise_stays_white(wrong):
    rng = np.random.default_rng(8)
    t_s = np.arange(9000) * 0.02
    r = 0.12 * rng.normal(size=len(t_s))
    if wrong == "outliers":
        r += 5.0 * (rng.random(len(r)) < 0.03)
    found = fit_noise([(t_s, r)])
    assert found.ou_sd == 0.0
    assert found.white_sd == pytest.approx(0.12, rel=0.03)


@pytest.mark.parametrize(("dof", "low", "high"), [(3.0, 2.4, 4.5), (6.0, 4.5, 9.0)])
def test_tails_are_recovered(dof, low, high):
    rng = np.random.default_rng(9)
    r = 0.1 * rng.standard_t(dof, 9000)
    found = fit_noise([(np.arange(len(r)) * 0.02, r)])
    assert low <= found.tail_dof <= high


def test_whitener_of_the_fit_leaves_independent_samples_after_outliers():
    rng = np.random.default_rng(10)
    t_s = stamps(6000, 0.05, rng)
    r = simulated(NAVIGATION, t_s, rng)
    r += 1.5 * (rng.random(len(r)) < 0.03)
    model = fit_noise([(t_s, r)])
    kept = np.abs(r - np.median(r)) < 0.75
    white = whitened(model, t_s, r - np.mean(r[kept]), kept.astype(float))[kept]
    assert white.std() == pytest.approx(1.0, abs=0.05)
    assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 0.05


@pytest.mark.parametrize(
    "spans",
    [
        [],
        [(np.zeros(0), np.zeros(0))],
        [(np.arange(3.0), np.full(3, np.nan))],
        [(np.arange(3.0), np.zeros(3))],
        [(np.arange(500.0), np.zeros(500))],
    ],
    ids=["none", "empty", "unknown", "short", "perfect"],
)
def test_without_noise_the_floor_remains(spans):
    assert fit_noise(spans) == NoiseModel(1e-9)


@pytest.mark.parametrize("gap_s", [1.0, 30.0], ids=["few", "far apart"])
def test_of_too_few_samples_all_may_be_noise(gap_s):
    """Taken for exact they would outweigh every other channel."""
    r = np.array([0.3, -0.1, 0.2, 0.1, -0.4, 0.2, 0.1])
    found = fit_noise([(gap_s * np.arange(len(r)), r)])
    assert found == NoiseModel(pytest.approx(np.sqrt(np.mean(r**2))))
    white, scale = short_noise([r[:3], r[3:]])
    assert white == found
    assert scale == found.sd


@pytest.mark.parametrize("n", [0, 7, 200])
def test_where_short_segments_differ_in_nothing_all_samples_count_alike(n):
    assert short_noise([np.zeros(n)]) == (NoiseModel(1e-9), 0.0)
    problem = toy.problem(np.zeros(200), {})
    problem.estimate_noise(np.zeros(200))
    assert (problem.weights == 1.0).all()


def test_short_spans_do_not_become_a_random_walk():
    rng = np.random.default_rng(11)
    model = NoiseModel(0.01, 0.05, 0.6)
    spans = [
        (t_s, simulated(model, t_s, rng))
        for t_s in [np.arange(40) * 0.05 for _ in range(200)]
    ]
    found = fit_noise(spans)
    assert found.sd == pytest.approx(model.sd, rel=0.25)


@pytest.mark.parametrize(("drive", "half_s"), [("fast", 0.51), ("mid", 0.60)])
def test_uwb_recording_shows_the_figures_of_its_readme(drive, half_s):
    _, errors = range_errors(drive)
    bias = np.median(errors, axis=0)
    assert bias.min() == pytest.approx(0.08, abs=0.02)
    assert bias.max() == pytest.approx(0.31, abs=0.02)
    rest = errors - bias
    assert 1.4826 * np.median(np.abs(rest)) == pytest.approx(0.068, abs=0.003)
    lag = 50  # about 0.5 s at 100 Hz
    rho = [np.corrcoef(v[:-lag], v[lag:])[0, 1] for v in rest.T]
    assert np.mean(rho) == pytest.approx(half_s, abs=0.02)


@pytest.mark.parametrize("drive", ["fast", "mid"])
def test_uwb_noise_is_coloured_and_its_whitener_fits(drive):
    t_s, errors = range_errors(drive)
    for channel in range(0, 24, 4):
        r = errors[:, channel] - np.median(errors[:, channel])
        model = fit_noise([(t_s, r)])
        assert 0.03 < model.ou_sd < 0.08
        assert 0.01 < model.white_sd < 0.045
        assert 0.1 < model.ou_tau_s < 0.6
        kept = np.abs(r) < 5.0 * model.sd
        white = whitened(model, t_s, r, kept.astype(float))[kept]
        assert np.corrcoef(r[1:], r[:-1])[0, 1] > 0.6
        assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 0.25

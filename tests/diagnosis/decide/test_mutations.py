"""What the search rests on: with one of these off, it takes a worse model of the same data.

Each mistake is judged by what becomes of data whose truth is known, never by what it changes in the
engine.
"""

from dataclasses import replace

import numpy as np
import pytest

from hilserver.diagnosis.decide import promise, selection, trial
from hilserver.diagnosis.decide.identifiability import with_best_rivals
from hilserver.diagnosis.regression.columns import Library
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.regression.gain import crossed, held_out
from tests.diagnosis import toy
from tests.diagnosis.mutation import mutated
from tests.diagnosis.regression import test_common_noise as common_noise

N = 2400


def what_a_model_misses_is_no_noise():
    """`part` misses what is white in `whole`, the truth: noise fitted to `part` would excuse it."""
    rng = np.random.default_rng(0)
    part = 30.0 * toy.smooth(rng, N)
    columns = {"whole": part + 0.8 * rng.normal(size=N), "part": part}
    problem = toy.problem(0.6 * columns["whole"] + rng.normal(size=N), columns)
    # too large and with a searched shape, so that `part` is tried alone, and costs less
    library, base = toy.library(problem, hidden={"whole": 3}, prior={"whole": 0.05})
    found = selection.select(problem, library, base, rng).point
    assert found.model.causes == ("whole",), "what is missed passes for noise"


def no_order_decides():
    """Of two models that explain the data alike, the one examined first is not preferred."""
    problem, library, *models = common_noise.two_models(common_noise.SHORT)
    leads = []
    for first in models:
        for _ in range(
            2
        ):  # the first time the columns are fitted under the other's weights
            selection.with_noise_anew(
                problem, library, problem.point(first.model, first.poses)
            )
        leads.append(common_noise.prefers_the_first(problem, *models))
    assert leads[0] == pytest.approx(leads[1], abs=10.0), "the first one is preferred"


def no_shape_takes_the_name_of_a_simple_cause():
    """The best of thirty edges of a region nearly always fits the noise a little better."""
    names = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        simple, x = 20.0 * toy.smooth(rng, N), toy.smooth(rng, N, 200)
        edges = np.linspace(-0.9, -0.3, 30) * np.abs(x).max()
        parts = {f"beyond {e:.3f}": np.where(x > e, simple, 0.0) for e in edges}
        problem = toy.problem(
            0.8 * simple + rng.normal(size=N), {"simple": simple, **parts}
        )
        base = problem.point(toy.model(), np.zeros((0, 3)))
        regions = [
            replace(toy.candidate(name, hidden=1), cause="region") for name in parts
        ]
        candidates = [toy.candidate("simple"), *regions]
        library = Library(
            problem, candidates, [problem.column(base, c) for c in candidates]
        )
        library.rewhiten(base)
        found = selection.select(problem, library, base, rng).point
        names.append(found.model.causes[0])
    assert names == ["simple"] * len(names), "a region without an effect"


def no_rival_makes_predictions_worse():
    """It imitates a few samples that are far off, which are much of the squares and little else."""
    rng = np.random.default_rng(0)
    good, far_off = 12.0 * toy.smooth(rng, N), np.zeros(N)
    far_off[[500, 501, 1200, 1201, 1900, 1901]] = 12.0
    columns = {"good": good, "rival": good + far_off + 3.5 * toy.smooth(rng, N)}
    problem = toy.problem(good + far_off + rng.normal(size=N), columns)
    library, base = toy.library(problem)
    before = fit(problem, toy.model("good"), base)
    after, _ = with_best_rivals(library, before)
    errors = [
        np.abs(problem.residual(held_out(problem, crossed(problem, p, p.model)))).mean()
        for p in (before, after)
    ]
    assert errors[1] < 1.01 * errors[0], "held-out blocks are predicted worse"


@pytest.mark.parametrize(
    ("function", "line", "changed", "holds", "says"),
    [
        pytest.param(
            selection._plausible,
            "sum(_cost(problem, s, n) for n in noises) for s in (first, other)",
            "_cost(problem, s, n) for s, n in zip((first, other), noises)",
            what_a_model_misses_is_no_noise,
            "passes for noise",
            id="common noise off",
        ),
        pytest.param(
            selection.with_noise_anew,
            "if problem.is_short:",
            "if False:",
            no_order_decides,
            "first one is preferred",
            id="common noise off in short segments",
        ),
        pytest.param(
            trial.cost,
            "return TIE * candidate.weight + INEXACT * candidate.hidden * explained",
            "return 0.0",
            no_shape_takes_the_name_of_a_simple_cause,
            "region without an effect",
            id="price off",
        ),
        pytest.param(
            promise._grows,
            "return bool(clear and",
            "return bool(False and",
            no_rival_makes_predictions_worse,
            "predicted worse",
            id="horizon veto off",
        ),
    ],
)
def test_what_a_comparison_rests_on(function, line, changed, holds, says):
    holds()
    with mutated(function, line, changed), pytest.raises(AssertionError, match=says):
        holds()
    holds()

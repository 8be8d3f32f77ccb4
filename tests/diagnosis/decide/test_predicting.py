"""Columns that predict without a name."""

import numpy as np
import pytest

from hilserver.diagnosis.decide import predicting
from hilserver.diagnosis.decide.predicting import (
    before_settling,
    halfway,
    with_nameless,
)
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.regression.stages import Prepared
from tests.diagnosis import toy

N = 4000


def prepared(size, *, memoryless=False, prior=np.inf):
    """A large cause, a further one of some size, and one that is not there."""
    rng = np.random.default_rng(4)
    columns = {name: toy.smooth(rng, N) for name in ("large", "further", "idle")}
    values = 3.0 * columns["large"] + size * columns["further"] + rng.normal(size=N)
    problem = toy.problem(values, columns)
    problem.stage.memoryless = memoryless
    library, base = toy.library(problem, prior={"further": prior})
    return Prepared(problem, library, base), fit(problem, toy.model("large"), base)


def test_what_held_out_blocks_confirm_predicts():
    p, named = prepared(1.0)
    rows = []
    whole = with_nameless(p, named, rows)
    assert whole.model.causes == ("large", "further")
    assert [(row.cause, row.action) for row in rows] == [("further", "refused")]
    assert rows[0].held_out_gain > 1.0


@pytest.mark.parametrize(
    "how",
    [
        {"size": 0.0},
        {"size": 0.6},
        {"size": 1.0, "memoryless": True},
        {"size": 1.0, "prior": 0.1},
    ],
    ids=["not there", "less than a hundredth", "of the drive", "implausibly large"],
)
def test_nothing_else_does(how):
    p, named = prepared(**how)
    rows = []
    assert with_nameless(p, named, rows) is named
    assert rows == []


def test_where_nothing_is_found_nothing_predicts():
    p, _ = prepared(1.0)
    assert with_nameless(p, p.base, []) is p.base


def test_a_column_stays_without_its_name_where_held_out_errors_would_grow():
    p, _ = prepared(0.0)
    both = fit(p.problem, toy.model("large", "idle"), p.base)
    only, none = (
        fit(p.problem, toy.model(*names), p.base) for names in (("large",), ())
    )
    rows = []
    assert before_settling(p.problem, only, [both], rows) is only
    assert rows == []
    assert before_settling(p.problem, none, [only, both], rows) is only
    (row,) = rows
    assert (row.cause, row.action) == ("large", "refused")
    assert row.held_out_gain < 0.95


@pytest.mark.parametrize("short", [True, False])
def test_ends_of_runs_count_where_the_noise_is_not_known(short, monkeypatch):
    p, named = prepared(1.0)
    monkeypatch.setattr(type(p.problem), "is_short", property(lambda problem: short))
    other = fit(p.problem, toy.model("large"), p.base, iterations=0)
    monkeypatch.setattr(
        predicting, "fit_by_ends", lambda problem, point, horizon_s: other
    )
    theta = halfway(p.problem, named).model.theta()
    assert theta == pytest.approx(named.model.theta() / (1.0 + short))

"""What no step may cost, and which extension is not written."""

import numpy as np
import pytest

from hilserver.diagnosis.decide.identifiability import with_best_rivals
from hilserver.diagnosis.decide.promise import ModelExchange, _grows
from hilserver.diagnosis.decide.revision import _harmless
from hilserver.diagnosis.findings.outcome import worsened
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.regression.gain import Errors, Pair
from hilserver.diagnosis.schema.findings import Gain
from tests.diagnosis import toy

BLOCK = np.repeat(np.arange(20), 4)


def pair(more, scatter):
    rng = np.random.default_rng(1)
    before = 1.0 + 0.5 * rng.random(len(BLOCK))
    by_block = more + scatter * rng.standard_normal(20)
    return Pair(Errors(before, BLOCK), Errors(before + by_block[BLOCK], BLOCK), 5.0)


@pytest.mark.parametrize(
    ("more", "scatter", "grows"),
    [(0.1, 0.05, True), (0.1, 1.0, False), (0.005, 0.001, False), (-0.1, 0.05, False)],
    ids=["clear", "by chance", "less than 1 %", "falls"],
)
def test_an_error_grows_if_it_does_so_clearly_and_by_more_than_a_hundredth(
    more, scatter, grows
):
    assert _grows(pair(more, scatter)) is grows


def test_samples_of_one_block_are_no_witnesses_of_each_other():
    """All that grows is in one block of twenty: many samples, one witness."""
    before = np.ones(2000)
    block = np.repeat(np.arange(20), 100)
    after = before + (block == 3)
    assert not _grows(Pair(Errors(before, block), Errors(after, block), 5.0))


def gain(ratio, ci95):
    return Gain(horizon_s=5.0, before=1.0, after=1.0 / ratio, ratio=ratio, ci95=ci95)


def test_an_extension_that_makes_a_quantity_worse_is_refused():
    better, open_ = gain(2.0, (1.5, 2.5)), gain(0.95, (0.9, 1.02))
    worse = gain(0.61, (0.46, 0.84))
    assert worsened({"yaw_rad": better, "position_m": open_}, {}) is None
    assert worsened({"position_m": gain(1.0, (1.0, 1.0))}) is None
    assert worsened({"position_m": worse}) is not None
    said = worsened({"yaw_rad": better}, {"position_m": worse})
    assert said is not None
    assert "position_m" in said
    assert "0.46 to 0.84" in said


def test_no_cause_goes_for_unknown_structure_where_held_out_errors_would_grow():
    rng = np.random.default_rng(4)
    needed, idle = (toy.smooth(rng, 2000) for _ in range(2))
    problem = toy.problem(
        3.0 * needed + rng.normal(size=2000), {"needed": needed, "idle": idle}
    )
    _, base = toy.library(problem)
    point = fit(problem, toy.model("needed", "idle"), base)
    assert _harmless(problem, point, [0, 1]) == {1}
    step = ModelExchange(problem, point, fit(problem, point.model.without(0), point))
    assert step.harms
    assert step.gain is not None
    assert step.gain < 0.95


@pytest.mark.parametrize(
    ("yaw", "position", "goes"),
    [(0.1, 0.0, False), (0.1, -0.1, True), (0.0, 0.0, True)],
    ids=["the yaw needs it", "it spoils the position", "nothing needs it"],
)
def test_no_cause_stays_beside_unknown_structure_that_makes_a_prediction_worse(
    yaw, position, goes, monkeypatch
):
    """What goes without it, in a model that one quantity needs and another suffers from."""
    rng = np.random.default_rng(4)
    column = toy.smooth(rng, 2000)
    problem = toy.problem(3.0 * column + rng.normal(size=2000), {"c": column})
    point = fit(problem, toy.model("c"), toy.library(problem)[1])
    found = {"yaw_rad": pair(yaw, 0.05), "position_m": pair(position, 0.05)}
    monkeypatch.setattr("hilserver.diagnosis.decide.promise.errors", lambda *_: found)
    assert _harmless(problem, point, [0]) == ({0} if goes else set())


@pytest.mark.parametrize("harms", [True, False])
def test_a_rival_with_larger_errors_on_held_out_blocks_takes_no_place(
    harms, monkeypatch
):
    """It leaves less all the same; whether errors grow is decided by blocks, see above."""
    rng = np.random.default_rng(4)
    good = toy.smooth(rng, 2000)
    poor = good + 0.6 * toy.smooth(rng, 2000)
    problem = toy.problem(
        5.0 * good + rng.normal(size=2000), {"good": good, "poor": poor}
    )
    library, base = toy.library(problem)
    point = fit(problem, toy.model("poor"), base)
    monkeypatch.setattr(ModelExchange, "harms", property(lambda step: harms))
    found, _ = with_best_rivals(library, point)
    assert found.model.causes == (("poor",) if harms else ("good",))

"""Selection, twins, drift and the smallest effect, on a regression whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest

from hilserver.diagnosis.decide.identifiability import (
    Rival,
    cosines,
    prune,
    with_best_rivals,
)
from hilserver.diagnosis.decide.revision import with_fewer
from hilserver.diagnosis.decide.selection import select
from hilserver.diagnosis.decide.structure import (
    holds_out,
    imitated,
    joint_gain,
    remaining,
)
from hilserver.diagnosis.decide.trial import cost
from hilserver.diagnosis.decide.unknown import Family
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.regression.screen import critical, null_maxima
from hilserver.diagnosis.replay.model import Model
from hilserver.diagnosis.thresholds import DETECTABLE_POWER_SD, GROUP_COSINE
from tests.diagnosis import toy

N = 3000


def columns_of(rng, *names):
    return {name: 20.0 * toy.smooth(rng, N) for name in names}


def selected(problem, seed=0):
    library, base = toy.library(problem)
    return library, select(problem, library, base, np.random.default_rng(seed))


def test_what_is_there_is_selected_and_nothing_else():
    for seed in range(6):
        rng = np.random.default_rng(seed)
        columns = columns_of(rng, *"abcdefgh")
        values = 0.5 * columns["b"] - 0.3 * columns["f"] + rng.normal(size=N)
        _, found = selected(toy.problem(values, columns))
        assert set(found.point.model.causes) == {"b", "f"}
        assert found.point.model.terms == pytest.approx({"b": 0.5, "f": -0.3}, abs=0.05)
        assert all(p <= 0.01 for p in found.p.values())


def test_nothing_is_selected_from_noise():
    for seed in range(20):
        rng = np.random.default_rng(100 + seed)
        problem = toy.problem(rng.normal(size=N), columns_of(rng, *"abcdefgh"))
        _, found = selected(problem)
        assert found.point.model.causes == ()


@pytest.mark.parametrize(
    ("cause", "taken"), [("coulomb_friction", 0), ("process_gain", 1)]
)
def test_what_friction_leaves_by_its_own_form_is_no_further_cause(cause, taken):
    """A column explains 1 % of the effect's size: of an exact cause's remainder that is much."""
    rng = np.random.default_rng(3)
    columns = columns_of(rng, cause, "rival")
    values = 100.0 * columns[cause] + 1.0 * columns["rival"] + rng.normal(size=N)
    _, found = selected(toy.problem(values, columns))
    assert found.point.model.causes == (cause, "rival")[: 1 + taken]


def test_of_two_that_explain_alike_the_one_without_a_shape_is_taken():
    """A region's edge can be bent around what a simple cause's form leaves: that is no region."""
    rng = np.random.default_rng(5)
    columns = columns_of(rng, "simple", "bend")
    columns["region"] = columns["simple"] + 0.05 * columns.pop("bend")
    values = 10.0 * columns["simple"] + 0.3 * (columns["region"] - columns["simple"])
    problem = toy.problem(values + rng.normal(size=N), columns)
    library, base = toy.library(problem, hidden={"region": 1})
    found = select(problem, library, base, rng)
    assert found.point.model.causes[0] == "simple"
    assert (
        cost(library.candidates[1], 1000.0) > cost(library.candidates[0], 1000.0) + 4.0
    )
    exchanged, _ = with_best_rivals(library, found.point)
    assert exchanged.model.causes[0] == "simple"


def twins(seed, likeness):
    """One effect, and a column that is `likeness` of it and the rest its own."""
    rng = np.random.default_rng(seed)
    columns = columns_of(rng, "true", "own", "other")
    own = columns.pop("own")
    columns["twin"] = likeness * columns["true"] + np.sqrt(1.0 - likeness**2) * own
    values = 0.5 * columns["true"] + rng.normal(size=N)
    problem = toy.problem(values, columns)
    library, base = toy.library(problem)
    return library, fit(problem, toy.model("true"), base)


def test_exact_twins_tie_and_others_do_not():
    for seed in range(5):
        library, point = twins(seed, 1.0)
        exchanged, ties = with_best_rivals(library, point)
        assert exchanged.model.causes == ("true",)
        assert [r.candidate.cause for r in ties["true"]] == ["twin"]
        assert ties["true"][0].cosine == pytest.approx(1.0, abs=1e-3)
        assert abs(ties["true"][0].worse) < 0.1
        library, point = twins(seed, 0.9)
        assert with_best_rivals(library, point)[1]["true"] == [], (
            "below 0.95 and clearly worse"
        )


def test_a_wrong_name_is_swapped_for_the_right_one():
    library, point = twins(3, 0.9)
    wrong = fit(library.problem, toy.model("twin"), point)
    exchanged, _ = with_best_rivals(library, wrong)
    assert exchanged.model.causes == ("true",)


def test_the_cosine_is_that_of_the_columns_without_what_others_explain():
    library, point = twins(4, 0.9)
    columns = library.problem.stage.columns
    plain = columns["true"] @ columns["twin"]
    plain /= np.linalg.norm(columns["true"]) * np.linalg.norm(columns["twin"])
    names = [c.cause for c in library.candidates]
    found = dict(zip(names, cosines(library, point, 0), strict=True))
    assert found["twin"] == pytest.approx(abs(plain), abs=1e-3)
    assert found["other"] < 0.6
    both = fit(library.problem, toy.model("twin", "true"), point)
    index = both.model.causes.index("true")
    rest = columns["true"] - columns["twin"] * (columns["true"] @ columns["twin"]) / (
        columns["twin"] @ columns["twin"]
    )
    other = columns["other"]
    aside = other - columns["twin"] * (other @ columns["twin"]) / (
        columns["twin"] @ columns["twin"]
    )
    wanted = abs(rest @ aside) / np.linalg.norm(rest) / np.linalg.norm(aside)
    found = dict(zip(names, cosines(library, both, index), strict=True))
    assert found["other"] == pytest.approx(wanted, abs=1e-3)
    assert 0.9 < GROUP_COSINE < 1.0


def test_a_superfluous_cause_is_pruned():
    rng = np.random.default_rng(5)
    columns = columns_of(rng, "a", "b")
    problem = toy.problem(0.5 * columns["a"] + rng.normal(size=N), columns)
    base = problem.point(Model(), np.zeros((0, 3)))
    both = fit(problem, toy.model("a", "b"), base)
    assert prune(problem, both).model.causes == ("a",)


def test_one_cause_stands_for_two_that_explain_no_more():
    """A radius turns and drives; with a scale that undoes the one it is a twin of the gain."""
    rng = np.random.default_rng(3)
    columns = columns_of(rng, "gain", "scale")
    columns["radius"] = columns["gain"] + columns["scale"]
    problem = toy.problem(0.5 * columns["gain"] + rng.normal(size=N), columns)
    library, base = toy.library(problem)
    point = fit(problem, toy.model("radius", "scale"), base)
    _, ties = with_best_rivals(library, point)
    fewer = with_fewer(problem, point, ties)
    assert fewer.model.terms == pytest.approx({"gain": 0.5}, abs=0.05)


def test_two_causes_stay_two_where_none_stands_for_both():
    rng = np.random.default_rng(4)
    columns = columns_of(rng, "gain", "scale")
    columns["twin"] = -2.0 * columns["gain"]
    values = 0.5 * columns["gain"] + 0.3 * columns["scale"] + rng.normal(size=N)
    problem = toy.problem(values, columns)
    library, base = toy.library(problem)
    point = fit(problem, toy.model("gain", "scale"), base)
    _, ties = with_best_rivals(library, point)
    assert [r.candidate.cause for r in ties["gain"]] == ["twin"]
    assert with_fewer(problem, point, ties) is None


def test_a_weak_cause_is_not_lost_with_a_rival_that_is_weaker_still():
    """A rival that ties may fall below what a cause must save; that says nothing of the cause."""
    rng = np.random.default_rng(11)
    columns = columns_of(rng, "own")
    columns["twin"] = columns["own"] + 20.0 * toy.smooth(rng, N)
    size = 3.6 / np.sqrt((columns["own"] ** 2).sum())
    problem = toy.problem(size * columns["own"] + rng.normal(size=N), columns)
    library, base = toy.library(problem)
    point = fit(problem, toy.model("own"), base)
    weaker = fit(problem, toy.model("twin"), base)
    rival = Rival(library.candidates[1], weaker, 0.99, 1.0, 0.1, gross=False)
    assert prune(problem, point).model.causes == ("own",)
    assert prune(problem, weaker).model.causes == ()
    assert with_fewer(problem, point, {"own": [rival]}) is None


def test_structure_must_hold_on_blocks_that_its_coefficients_were_not_fitted_to():
    rng = np.random.default_rng(6)
    problem = toy.problem(rng.normal(size=N), columns_of(rng, "a"))
    family = np.stack(list(columns_of(rng, *"bcdefghij").values()), axis=1)
    left = rng.normal(size=N)
    assert not holds_out(problem, family, left)
    assert joint_gain(family, left) < 40.0
    there = left + 0.4 * family[:, 2] - 0.4 * family[:, 7]
    assert holds_out(problem, family, there)
    assert joint_gain(family, there) > 100.0
    once = np.where(problem.stack.fold[problem.stack.block] == 0, there, left)
    assert not holds_out(problem, family, once), "in one half of the blocks alone"
    assert joint_gain(np.zeros((N, 2)), left) == 0.0


def test_an_effect_of_the_smallest_visible_size_is_usually_seen():
    rng, seen = np.random.default_rng(7), 0
    for _ in range(60):
        columns = columns_of(rng, *"abcd")
        problem = toy.problem(rng.normal(size=N), columns)
        library, base = toy.library(problem)
        scores = library.scores(base)
        limit = critical(null_maxima([scores], rng, flips=999))
        size = (
            (limit + DETECTABLE_POWER_SD) * scores.deviation[0] / scores.information[0]
        )
        values = problem.stack.values + size * columns["a"]
        library, base = toy.library(toy.problem(values, columns))
        scores = library.scores(base)
        seen += abs(scores.t[0]) > critical(null_maxima([scores], rng, flips=999))
    assert 0.65 <= seen / 60 <= 0.97, f"{seen} of 60"


def test_columns_of_zeros_and_of_any_unit_have_a_ridge_fit():
    rng = np.random.default_rng(8)
    columns = columns_of(rng, "a", "b") | {"nothing": np.zeros(N)}
    columns["b"] *= 1e-6
    problem = toy.problem(0.5 * columns["a"] + rng.normal(size=N), columns)
    library, base = toy.library(problem)
    weight = library.ridge(base)
    assert np.isfinite(weight).all()
    assert weight[0] == pytest.approx(0.5, abs=0.05)
    effect = library.effect(weight, slice(None))
    assert effect == pytest.approx(0.5 * columns["a"], abs=2.0)


def test_a_cause_yields_to_a_column_of_unknown_structure_that_explains_more():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        columns = columns_of(rng, "named", "own", "aside")
        truth = 0.9 * columns["named"] + np.sqrt(1.0 - 0.9**2) * columns["own"]
        history = Family("history", ("velocity.linear_m_s",), truth[:, None])
        aside = Family("time", ("t_s",), columns["aside"][:, None])
        for values, wanted in ((truth, 0), (columns["named"], None)):
            problem = toy.problem(
                0.5 * values + rng.normal(size=N), {"named": columns["named"]}
            )
            base = problem.point(Model(), np.zeros((0, 3)))
            point = fit(problem, toy.model("named"), base)
            assert imitated(problem, point, [aside, history]) == wanted


@pytest.mark.parametrize("phase", [0.0, 0.25 * np.pi])
def test_an_error_of_one_sensor_yields_to_a_motion_that_all_of_them_see(phase):
    """A cable pulled the robot round, and the heading alone was named as wrong.

    Both are waves, of two columns whatever the phase; the heading has a quarter of the samples.
    """
    rng = np.random.default_rng(9)
    waves = np.stack([toy.smooth(rng, N), toy.smooth(rng, N)], axis=1)
    is_heading = np.arange(N) % 4 == 0
    columns = dict(zip("cs", np.where(is_heading, waves.T, 0.0), strict=True))
    one = toy.candidate("heading")
    wave = replace(
        one,
        terms=lambda theta: dict(zip("cs", theta, strict=True)),
        **{
            name: 2 * getattr(one, name)
            for name in ("start", "null", "step", "low", "high")
        },
    )
    family = Family("heading", ("nav.yaw_rad",), waves)
    motion = 15.0 * waves @ [np.cos(phase), np.sin(phase)]
    for values, wanted in ((motion, 0), (np.where(is_heading, motion, 0.0), None)):
        problem = toy.problem(values + rng.normal(size=N), columns)
        base = problem.point(Model(), np.zeros((0, 3)))
        point = fit(problem, Model().plus(wave, wave.start), base)
        assert imitated(problem, point, [family]) == wanted


def test_a_column_that_explains_only_what_it_was_fitted_to_puts_no_cause_in_doubt():
    """It follows the noise of this very log; on the other half of the blocks it says nothing."""
    rng = np.random.default_rng(3)
    columns = columns_of(rng, "named")
    noise = 4.0 * rng.normal(size=N)
    problem = toy.problem(0.5 * columns["named"] + noise, columns)
    point = fit(problem, toy.model("named"), problem.point(Model(), np.zeros((0, 3))))
    half = problem.stack.fold[problem.stack.block] == 0
    learned = 0.5 * columns["named"] + np.where(half, noise, -0.2 * noise)
    family = Family("time", ("t_s",), learned[:, None])
    assert imitated(problem, point, [family]) is None


def test_a_gross_misfit_is_never_left_without_a_word():
    rng = np.random.default_rng(7)
    values, columns = rng.normal(size=N), columns_of(rng, "a", "b")
    family = Family("turn", ("velocity.angular_rad_s",), columns["b"][:, None])
    quiet = toy.problem(values, {"a": columns["a"]})
    none = np.zeros((0, 3))
    assert remaining(quiet, quiet.point(Model(), none), rng, [family], 0.0) == []
    # one block alone: no test that counts blocks can be sure of it
    burst = np.where(np.arange(N) < 50, 40.0, 0.0) * columns["b"]
    loud = toy.problem(values + burst, {"a": columns["a"]})
    loud.stage.follows_setpoints = False
    found = remaining(loud, loud.point(Model(), none), rng, [family], 0.0)
    assert [u.family.name for u in found] == ["turn"]
    # of which one may have come and gone between two rows
    loud.stage.follows_setpoints = True
    assert remaining(loud, loud.point(Model(), none), rng, [family], 0.0) == []

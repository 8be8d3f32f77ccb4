"""A first choice that no machine would have is left where others explain as much."""

from dataclasses import replace

import numpy as np
import pytest

from hilserver.diagnosis.decide.delays import beginning_for
from hilserver.diagnosis.decide.identifiability import Rival
from hilserver.diagnosis.decide.revision import _weighed, no_name
from hilserver.diagnosis.decide.selection import (
    Selected,
    _detour,
    _plausible,
    _simpler,
    select,
)
from hilserver.diagnosis.decide.trial import not_alone
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.regression.stages import Prepared
from hilserver.diagnosis.replay.model import Model
from tests.diagnosis import toy

N = 2400
LURE = {"lure": 0.05}


def selected(values, columns):
    problem = toy.problem(values, columns)
    library, base = toy.library(problem, hidden={"surface_change": 2}, prior=LURE)
    rng = np.random.default_rng(0)
    return select(problem, library, base, rng)


def two_and_a_lure():
    """Two causes, and one that looks like their sum: it explains more than either alone."""
    rng = np.random.default_rng(1)
    a, b, aside = (30.0 * toy.smooth(rng, N) for _ in range(3))
    return rng.normal(size=N), {"a": a, "b": b, "lure": a + b + 0.3 * aside}


@pytest.fixture
def drawn():
    return two_and_a_lure()


def test_two_causes_stand_for_one_that_is_far_too_large(drawn):
    noise, columns = drawn
    found = selected(0.6 * columns["a"] + 0.6 * columns["b"] + noise, columns)
    assert sorted(found.point.model.causes) == ["a", "b"]
    assert found.point.model.theta() == pytest.approx([0.6, 0.6], abs=0.1)
    assert ("lure", "swapped") in {(row.cause, row.action) for row in found.rows}


@pytest.mark.parametrize(
    ("share", "causes"),
    [
        (1.0, ["nav_scale", "rotation_gain"]),
        (0.97, ["nav_scale", "rotation_gain"]),
        (0.6, ["surface_change"]),
    ],
)
def test_what_acts_on_the_whole_floor_is_no_part_of_it(share, causes):
    """A region of nearly all places was named for a rotation gain and a slip at once."""
    rng = np.random.default_rng(2)
    turn, ahead = (30.0 * toy.smooth(rng, N) for _ in range(2))
    on_part = np.where(np.arange(N) % 100 < 100 * share, turn + ahead, 0.0)
    columns = {"rotation_gain": turn, "nav_scale": ahead, "surface_change": on_part}
    truth = turn + ahead if share > 0.9 else on_part
    found = selected(0.6 * truth + rng.normal(size=N), columns)
    assert sorted(found.point.model.causes) == causes


def test_what_alone_explains_the_data_stays_whatever_its_size(drawn):
    noise, columns = drawn
    found = selected(0.6 * columns["lure"] + noise, columns)
    assert found.point.model.causes == ("lure",)


@pytest.mark.parametrize(
    ("size", "inexact", "causes"),
    [
        (0.0, 0.02, ["process_gain", "stribeck_friction"]),
        (0.0, 0.2, ["coulomb_friction", "time_constant", "viscous_load"]),
        (1.0, 0.02, ["coulomb_friction", "time_constant", "viscous_load"]),
    ],
)
def test_the_few_causes_stand_for_several_that_only_make_up_for_the_first_choice(
    size, inexact, causes
):
    """The first looks like the sum of two, two others undo the rest; no swap leads back.

    The three explain the error of the two causes' form as well. What is far more than that error,
    or nothing that the two explain, needs all three.
    """
    rng = np.random.default_rng(2)
    gain, friction, u, v, form = (30.0 * toy.smooth(rng, N) for _ in range(5))
    columns = {
        "process_gain": gain,
        "stribeck_friction": friction,
        "coulomb_friction": gain + friction + u,
        "time_constant": u + v,
        "viscous_load": v + inexact * form,
    }
    values = gain + friction + inexact * form + size * (2.0 * u + 3.0 * v)
    problem = toy.problem(values + rng.normal(size=N), columns)
    library, base = toy.library(problem)
    found = select(problem, library, base, rng)
    weighed, _ = _weighed(Prepared(problem, library, base), found)
    assert sorted(weighed.model.causes) == causes


@pytest.fixture
def three():
    """Data of two causes, a third that is not there, and what fits any of them."""
    rng = np.random.default_rng(4)
    names = ("coulomb_friction", "time_constant", "viscous_load")
    columns = {name: 30.0 * toy.smooth(rng, N) for name in names}
    values = columns["coulomb_friction"] + columns["time_constant"] + rng.normal(size=N)
    problem = toy.problem(values, columns)
    _, base = toy.library(problem)
    return problem, lambda *of: fit(problem, toy.model(*of), base)


def test_only_a_choice_of_the_search_is_in_doubt_and_only_where_wheels_stick(three):
    _, fitted = three
    point = fitted("coulomb_friction", "time_constant", "viscous_load")
    p = dict.fromkeys(point.model.causes, 0.01)
    chosen = Selected(point, p, near={"coulomb_friction": [], "time_constant": []})
    assert _detour(chosen) == {"coulomb_friction"}
    running = Selected(point, p, near={"time_constant": [], "viscous_load": []})
    assert not _detour(running), (
        "the friction runs already; what was chosen acts smoothly"
    )
    assert not _detour(Selected(point, p)), "the search has chosen nothing"
    assert not _detour(
        replace(chosen, point=fitted("coulomb_friction", "time_constant"))
    )


def test_fewer_causes_that_predict_held_out_blocks_worse_are_not_simpler(three):
    problem, fitted = three
    all_three = fitted("coulomb_friction", "time_constant", "viscous_load")
    assert _simpler(problem, all_three, fitted("coulomb_friction", "time_constant"))
    assert not _simpler(problem, all_three, fitted("coulomb_friction", "viscous_load"))
    assert not _simpler(problem, all_three, all_three)


@pytest.mark.parametrize("others_help", [True, False])
def test_a_cause_at_its_bound_explains_nothing(drawn, others_help):
    """Others stand for it even if they explain less; without any there is no name at all."""
    noise, columns = drawn
    problem = toy.problem(0.6 * columns["lure"] + noise, columns)
    library, base = toy.library(problem)
    edge = replace(toy.candidate("lure"), high=(0.5,))
    at_edge = fit(problem, Model().plus(edge, (0.1,)), base)
    assert at_edge.model.theta() == pytest.approx(0.5)
    other = fit(problem, toy.model("a"), base) if others_help else base
    found = _plausible(
        problem, library, base, lambda barred: Selected(other if barred else at_edge)
    )
    assert found.point.model.causes == (("a",) if others_help else ())


@pytest.mark.parametrize(
    ("elsewhere", "own", "names"),
    [(0.05, 0.0, ()), (0.05, 0.9, ("part",)), (1.0, 0.0, ("whole",))],
)
def test_one_block_is_no_evidence_and_hides_none(elsewhere, own, names):
    """`whole` explains more than `part`, nearly all of it in one block; `aside` is part's alone."""
    rng = np.random.default_rng(3)
    shape, burst, aside = (
        3.0 * toy.smooth(rng, N),
        np.zeros(N),
        3.0 * toy.smooth(rng, N),
    )
    burst[110:140] = 40.0
    part = shape * (elsewhere + 0.3 * burst) + 0.3 * aside
    columns = {"whole": shape * (elsewhere + burst), "part": part}
    found = selected(columns["whole"] + own * aside + rng.normal(size=N), columns)
    assert found.point.model.causes == names


def test_a_delay_in_the_place_of_another_begins_with_its_value():
    late = Model().plus(toy.candidate("nav_latency"), (0.4,)).fitted[0]
    assert beginning_for(late, toy.candidate("clock_offset")) == (0.4,)
    slip = toy.candidate("side_slip")
    assert beginning_for(late, slip) == slip.beginning


@pytest.mark.parametrize(
    ("information", "used"),
    [
        ([9.0, 1.0, 2.0, 1.0], [0, 1, 1, 1]),
        ([9.0, 4.0, 3.0, 3.0], [1, 1, 1, 1]),
        ([99.0, 9.0, 1.0, 1.0, 1.0], [0, 0, 1, 1, 1]),
        ([5.0, 0.0, 0.0], [1, 1, 1]),
        ([0.0, 0.0], [1, 1]),
    ],
)
def test_a_block_with_more_information_than_all_others_does_not_count(
    information, used
):
    assert not_alone(np.array(information)).tolist() == [bool(u) for u in used]


def rival(problem, point, name, theta, prior):
    """A cause in the place of the only one of a model, which it cannot be told from."""
    other = Model().plus(toy.candidate(name, prior=prior), (theta,))
    return Rival(
        other.fitted[0].candidate,
        replace(point, model=other),
        1.0,
        0.0,
        0.0,
        gross=False,
    )


@pytest.mark.parametrize(
    ("theta", "high", "rival_prior", "stays"),
    [
        (0.19, 1.0, None, True),
        (0.21, 1.0, None, False),
        (0.21, 1.0, 0.05, False),
        (0.21, 1.0, np.inf, True),
        (0.19, 0.19, np.inf, False),
    ],
)
def test_a_size_that_no_machine_has_is_no_finding_alone(
    drawn, theta, high, rival_prior, stays
):
    """Four prior deviations are 0.2; behind a plausible cause it may stand in a group."""
    noise, columns = drawn
    problem = toy.problem(theta * columns["lure"] + noise, columns)
    made = replace(toy.candidate("lure", prior=0.05), high=(high,))
    point = replace(
        problem.point(Model(), np.zeros((0, 3))), model=Model().plus(made, (theta,))
    )
    ties = (
        {}
        if rival_prior is None
        else {"lure": [rival(problem, point, "a", theta, rival_prior)]}
    )
    why = no_name(problem, point.model.fitted[0], ties)
    assert (why is None) == stays, why

"""A search that starts at what runs: totals, what is new beside them, what is no longer there."""

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st

from hilserver.diagnosis.catalogue.library import drive_candidates, pose_candidates
from hilserver.diagnosis.decide.beginning import begun, causes_of
from hilserver.diagnosis.decide.selection import select
from hilserver.diagnosis.replay.model import Model
from tests.diagnosis import toy

N = 2400
LIBRARY = [*drive_candidates(), *pose_candidates((-3.0, 3.0, -3.0, 3.0))]


def columns_of():
    rng = np.random.default_rng(1)
    return {name: 30.0 * toy.smooth(rng, N) for name in ("a", "b", "c")}


def searched(hidden, running, columns=None):
    columns = columns_of() if columns is None else columns
    noise = np.random.default_rng(2).normal(size=N)
    values = sum(size * columns[name] for name, size in hidden.items()) + noise
    problem = toy.problem(values, columns)
    library, base = toy.library(problem)
    return select(problem, library, base, np.random.default_rng(0), running=running)


def test_what_runs_is_estimated_as_a_total_and_what_is_new_beside_it():
    found = searched({"a": 0.6, "b": 0.4}, {"a": 0.5})
    assert sorted(found.point.model.causes) == ["a", "b"]
    assert found.point.model.terms == pytest.approx({"a": 0.6, "b": 0.4}, abs=0.05)
    assert found.rows[0].cause == "a"
    assert "already active" in found.rows[0].reason
    assert found.p["a"] < 1e-6


@pytest.mark.parametrize("running", [{"a": 0.5}, {"a": 1e-4}])
def test_what_is_no_longer_there_or_does_not_show_is_left_out(running):
    assert searched({"b": 0.4}, running).point.model.causes == ("b",)


def test_a_term_without_a_cause_here_is_left_out():
    assert searched({"a": 0.6}, {"a": 0.6, "nav_latency": 0.1}).point.model.causes == (
        "a",
    )


def test_without_a_cause_the_beginning_is_the_configuration():
    columns = columns_of()
    problem = toy.problem(np.random.default_rng(2).normal(size=N), columns)
    library, base = toy.library(problem)
    assert begun(problem, library, base, {}) is base
    assert begun(problem, library, base, {"a": 0.4}, barred={"a"}) is base


def totals(fitted):
    return Model(tuple(fitted)).terms


VALUES = st.floats(0.01, 0.4)
SINGLES = st.dictionaries(
    st.sampled_from(
        ["rotation_gain", "nav_latency", "actuation_delay", "saturation_limit"]
    ),
    VALUES,
    min_size=1,
)


@hypothesis.given(terms=SINGLES)
def test_every_term_that_has_a_cause_begins_as_it_runs(terms):
    assert totals(causes_of(LIBRARY, terms)) == terms


REGION = {"x_min": -1000.0, "x_max": 0.123, "y_min": -1000.0, "y_max": 1000.0}


@pytest.mark.parametrize(
    "terms",
    [
        {"heading_distortion.a1": 0.1, "heading_distortion.phase1": 1.2},
        {"heading_distortion.a2": 0.1, "heading_distortion.phase2": -2.0},
        {"wheel_load.f": 2.5, "wheel_load.wheel": 2.0},
        {"stribeck_friction.f_s": 3.0, "stribeck_friction.n_s": 7.5},
        {"controller_gains.p": -0.3, "controller_gains.i": 0.1},
        {"controller_gains.p": -0.3},
        {"nav_lever_arm.x": 0.03, "nav_lever_arm.y": -0.05},
        {"surface_change.k_om": 0.3, "surface_change.v": 0.0}
        | {f"surface_change.{key}": value for key, value in REGION.items()},
        {"no_such_term": 1.0} | {"rotation_gain": 0.1},
    ],
)
def test_a_shape_stays_as_it_runs(terms):
    made = totals(causes_of(LIBRARY, terms))
    assert made == pytest.approx(
        {n: v for n, v in terms.items() if n != "no_such_term"}
    )

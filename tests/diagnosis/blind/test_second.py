"""The second generator: every cause that it has acts, and it refuses what it does not have."""

import subprocess

import numpy as np
import pytest
from hilserver_injector import CAUSES, single

from tests.diagnosis.blind import second

SEEDS = (7, 8)
LENGTH_S = {"drive": 25.0, "bench": 3.0}
SPEEDS = [f"wheel.{wheel}.speed_rpm" for wheel in ("fl", "rl", "fr", "rr")]
ABLE = [name for name, cause in CAUSES.items() if second.can_hide([cause.parameter])]
EFFECTS = {"periodic.turn": 0.05, "cable_drag.turn": 0.2, "hysteresis": 0.12}


def made(kind, causes):
    return second.make(kind, LENGTH_S[kind], *SEEDS, causes)


def differ(one, other):
    return any(
        not np.array_equal(one.columns[name], other.columns[name], equal_nan=True)
        for name in one.columns
    )


@pytest.fixture(scope="module")
def without():
    return {kind: made(kind, {}) for kind in LENGTH_S}


def test_it_hides_all_but_three_causes_of_the_library():
    assert CAUSES.keys() - set(ABLE) == {
        "roller_slip",
        "backlash",
        "friction_anisotropy",
    }


@pytest.mark.parametrize("cause", ABLE)
def test_every_cause_changes_its_log(without, cause):
    kind = CAUSES[cause].kind
    assert differ(made(kind, single(cause, 1, 2.0).causes), without[kind])


def test_effects_outside_the_library_change_the_log_too(without):
    for name, size in EFFECTS.items():
        assert differ(made("drive", {name: size}), without["drive"]), name


def test_seeds_make_the_log_and_nothing_else_does(without):
    again = made("drive", {})
    assert not differ(again, without["drive"])
    noisy = second.make("drive", LENGTH_S["drive"], SEEDS[0], SEEDS[1] + 1, {})
    at_rest = slice(0, 35)
    left = [
        noisy.columns[name][at_rest] - again.columns[name][at_rest] for name in SPEEDS
    ]
    assert 0.1 < np.nanstd(left) / np.sqrt(2.0) < 0.14, (
        "another noise on the same drive"
    )


def test_what_it_does_not_know_it_refuses():
    with pytest.raises(subprocess.CalledProcessError) as refused:
        made("drive", {"roller_slip": 0.1})
    assert refused.value.returncode == 2
    assert "roller_slip: not a cause" in refused.value.stderr


def test_it_shares_nothing_with_the_plant_and_the_first_generator():
    text = second.SOURCE.read_text(encoding="utf-8")
    assert '#include "' not in text

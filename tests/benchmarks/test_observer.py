"""The observer's figures: a short row of drives with a known patch; long: diagnosed ones."""

from argparse import Namespace

import numpy as np
import pytest
from hilserver_injector import Recipe

from benchmarks.observer import figures, run
from benchmarks.observer_drives import score
from hilserver.config.observer import Found, constants_of
from hilserver.plant.parameters import RobotParameters
from tests.commands.test_observe import FOUND

TERMS = {"rotation_gain": 0.03, "wheel_radius": -0.04}


def test_a_short_row_of_drives_whose_patch_is_known():
    robot = RobotParameters(terms=TERMS)
    c = constants_of(robot, Found.model_validate(FOUND))
    scores = [score("known", Recipe(seed=3, causes=TERMS), robot, c, k) for k in range(6)]
    assert 0.5 < np.mean([one.nees for one in scores]) < 8.0
    assert np.median([one.observer_m for one in scores]) < 0.2
    by_name = {(r.name, r.reference_name): r for r in figures(scores)}
    assert by_name["error then", "wheels alone, unpatched"].ratio > 3.0
    assert by_name["pose inside 95 %", "wanted"].raw[1] > 0.8


@pytest.mark.long
@pytest.mark.timeout(40_000)
def test_two_hundred_diagnosed_robots(tmp_path):
    results = run(Namespace(diagnoses=200, drives=5, keep=tmp_path))
    by_name = {(r.name, r.reference_name): r for r in results}
    assert by_name["pose inside 95 %", "wanted"].value > 0.9
    assert by_name["after 60 s alone: inside 95 %", "wanted"].value > 0.93
    assert by_name["error then", "wheels alone, unpatched"].ratio > 5.0
    assert by_name["error then", "default covariances"].ratio > 2.0

"""The observer's figures: a short row of drives with a known patch; long: diagnosed ones."""

import json
from argparse import Namespace

import numpy as np
import pytest
from hilserver_injector import Recipe

from benchmarks import observer, observer_recordings
from benchmarks.observer import figures, run
from benchmarks.observer_drives import Known, Score, diagnosed, score
from hilserver.config.observer import Found, constants_of
from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.errors import FailedError
from hilserver.plant.parameters import RobotParameters
from tests.commands.test_observe import FOUND
from tests.helpers.recordings import recording

TERMS = {"rotation_gain": 0.03, "wheel_radius": -0.04}


def test_a_short_row_of_drives_whose_patch_is_known():
    robot = RobotParameters(terms=TERMS)
    c = constants_of(robot, Found.model_validate(FOUND))
    scores = [
        score("known", Recipe(seed=3, causes=TERMS), Known(robot, c), k)
        for k in range(6)
    ]
    assert 0.5 < np.mean([one.nees for one in scores]) < 8.0
    assert np.median([one.observer_m for one in scores]) < 0.2
    by_name = {(r.name, r.reference_name): r for r in figures(scores)}
    assert by_name["error then", "wheels alone, unpatched"].ratio > 3.0
    assert by_name["pose inside 95 %", "wanted"].raw[1] > 0.8


def test_a_row_that_was_stopped_goes_on(tmp_path, monkeypatch):
    done = []

    def scored(one):
        done.append(one.key)
        return [Score(key, 3.0, 2.0, 0.1, 1.0, 0.3) for key in sorted(one.drives)]

    monkeypatch.setattr(observer, "scored", scored)
    for diagnoses in (2, 3):
        args = Namespace(
            diagnoses=diagnoses, drives=2, jobs=1, keep=tmp_path, recordings=None
        )
        results = run(args)
    assert len(done) == len(set(done)) == 3
    (nees,) = [r for r in results if r.name == "NEES of the pose, mean"]
    assert nees.value == 3.0
    assert len((tmp_path / "drives.jsonl").read_text().splitlines()) == 6


def test_real_robots_are_found_while_the_navigation_is_silent(tmp_path, monkeypatch):
    folder = recording("diffdrive_umbmark")
    (tmp_path / folder.name).mkdir()
    for name, link in (
        ("square_231220200045", "square_230620202042"),
        2 * ("circular_231220200154",),
    ):
        (tmp_path / folder.name / f"{link}.csv").symlink_to(folder / f"{name}.csv")

    def known(_, __, config, *___):
        robot = assemble_config(config).robot
        noise = {**FOUND["noise"], "nav.yaw_rad": {"white_sd": 0.01}}
        noise |= {f"nav.{axis}_m": {"white_sd": 0.003} for axis in "xy"}
        return Known(
            robot, constants_of(robot, Found.model_validate(FOUND | {"noise": noise}))
        )

    monkeypatch.setattr(observer_recordings, "diagnosed", known)
    args = Namespace(recordings=tmp_path, keep=tmp_path, jobs=1, undiagnosed=False)
    by_name = {(r.name.partition(": ")[2], r.reference_name): r for r in run(args)}
    assert by_name["error", "wheels since the cut"].value < 0.1
    assert by_name["error", "wheels since the start"].ratio > 1.0
    assert by_name["NIS inside 95 %", "wanted"].value > 0.5
    assert by_name["RMS of the smoother", "filter"].ratio > 1.0
    there = by_name["RMS where the pose is there", "constant covariances"]
    assert there.value < 0.002


def test_stamps_that_a_diagnosis_found_late_are_put_right(tmp_path):
    drift = {"verdict": "drift", "parameters": {"clock_offset.nav": {"value": 0.05}}}
    (tmp_path / "findings.json").write_text(json.dumps(FOUND | {"findings": [drift]}))
    assert diagnosed(tmp_path, list, Config(), 0).late_s == 0.05


def test_a_folder_without_recordings_gets_a_sentence(tmp_path):
    with pytest.raises(
        FailedError, match="holds no recordings of diffdrive_umbmark, omni4"
    ):
        run(Namespace(recordings=tmp_path, keep=tmp_path, jobs=1, undiagnosed=False))


@pytest.mark.long
@pytest.mark.timeout(40_000)
def test_two_hundred_diagnosed_robots(tmp_path):
    results = run(
        Namespace(diagnoses=200, drives=5, jobs=2, keep=tmp_path, recordings=None)
    )
    by_name = {(r.name, r.reference_name): r for r in results}
    assert by_name["pose inside 95 %", "wanted"].value > 0.9
    assert by_name["after 60 s alone: inside 95 %", "wanted"].value > 0.93
    assert by_name["error then", "wheels alone, unpatched"].ratio > 5.0
    assert by_name["error then", "default covariances"].ratio > 2.0

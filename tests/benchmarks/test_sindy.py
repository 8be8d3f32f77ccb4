"""PySINDy beside the diagnosis: what its terms name, what they gain, and the process beside it."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from hilserver_injector import Recipe, make
from hilserver_injector.cases import null, singles

from benchmarks import diagnose
from benchmarks.baselines import RIVALS
from benchmarks.campaign_rivals import compared, scored
from benchmarks.diagnose_rivals import rival_table
from benchmarks.diagnose_worker import measured
from benchmarks.sindy import CAUSES, mapped, said, sparse
from hilserver.daemon.assembly import assemble
from hilserver.diagnosis.progress import Tracker
from hilserver.diagnosis.regression.stages import prepare_all
from hilserver.errors import FailedError
from hilserver.plant.terms import TERMS
from tests.benchmarks.test_diagnose import arguments

ALL = frozenset({"ahead", "aside", "turn", "gyro"})


@pytest.fixture(scope="module")
def prepared():
    recipe = Recipe(seed=3, causes={"rotation_gain": -0.3}, duration_s=60.0)
    log = measured(make(recipe)[0])
    slim = replace(log, channels={n: log[n] for n in log.channels if "duty" not in n})
    return prepare_all(slim, assemble(None).robot, 1, Tracker())[0]["pose"]


def test_pysindy_names_a_large_rotation_gain(prepared):
    assert ["rotation_gain"] in said(prepared)


def test_rivals_on_velocities_gain_on_held_out_blocks(prepared, monkeypatch):
    for other in ("nine terms", "nine terms, end errors", "stepwise"):
        monkeypatch.delitem(RIVALS, other)
    found = compared(prepared)
    assert list(found) == ["PySINDy", "Gaussian process"]
    for gain in found.values():
        assert gain["yaw_rad"] > 3.0
        assert gain["gyro_z_rad_s"] > 3.0


def test_weights_are_few_and_true():
    rng, block = np.random.default_rng(1), np.repeat(np.arange(12), 50)
    columns = rng.normal(size=(600, 5)) * [1.0, 10.0, 0.1, 1.0, 1.0]
    left = columns @ [0.2, 0.0, 3.0, 0.0, 0.0] + 0.05 * rng.normal(size=600)
    assert sparse(columns, left, block) == pytest.approx(
        [0.2, 0.0, 3.0, 0.0, 0.0], rel=0.05
    )


def test_noise_alone_has_no_weights():
    rng, block = np.random.default_rng(1), np.repeat(np.arange(12), 50)
    assert not sparse(
        rng.normal(size=(600, 5)), 0.05 * rng.normal(size=600), block
    ).any()


@pytest.mark.parametrize("cause", CAUSES)
def test_the_terms_of_a_cause_name_it(cause):
    assert cause in {term.cause for term in TERMS.values()}
    assert cause in mapped(set(CAUSES[cause]), ALL)[0]


def test_terms_name_the_causes_that_make_most_of_them():
    assert mapped({("turn", "om"), ("gyro", "om")}, ALL) == [["rotation_gain"]]
    assert mapped({("turn", "om")}, ALL - {"gyro"}) == [["rotation_gain"]]
    assert mapped({("aside", "v"), ("gyro", "1")}, ALL) == [
        ["wheel_misalignment", "nav_frame_yaw"],
        ["gyro_bias"],
    ]
    assert mapped({("turn", "1")}, ALL) == []


def test_a_group_that_holds_the_truth_is_right():
    case, sound = next(singles(1, names=("nav_scale",))), next(null(1))
    assert scored(case, [["nav_scale", "traction_slip"]]).outcome == "right"
    assert scored(case, [["gyro_bias"]]).wrong == ["gyro_bias"]
    assert scored(case, []).outcome == "missed"
    assert scored(sound, []).outcome == "right"
    assert scored(sound, [["gyro_bias"]]).outcome == "false_alarm"


def test_each_rival_is_a_column():
    said = {"outcome": "right", "wrong": []}
    rivals = {"nine terms": {"yaw_rad": 2.0}, "PySINDy": {"yaw_rad": 8.0}}
    log = {"group": "single", **said, "gain": {"yaw_rad": 4.0}, "gains": rivals}
    other = log | {"gain": {}, "pysindy": {"outcome": "right", "wrong": ["icr_offset"]}}
    table = rival_table([log | {"pysindy": said}, other])
    assert "| measure | logs | diagnosis | nine terms | PySINDy |" in table
    assert "| right name, and no other | 2 | 2 |  | 1 |" in table
    assert "| gain in yaw, single cause | 2 | 2.00 | 2.00 | 8.00 |" in table
    assert rival_table([said]) == []


def test_without_pysindy_one_sentence_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pysindy", None)
    with pytest.raises(FailedError, match=r"pip install 'hilserver\[rivals\]'"):
        diagnose.run(arguments(tmp_path, words=["--rivals"]))

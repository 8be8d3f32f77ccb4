"""The rival that is given the cause: value and interval, or what to install."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import pytest
from hilserver_injector import make
from hilserver_injector.cases import singles

from benchmarks import diagnose, diagnose_worker, sysid
from benchmarks.diagnose_table import markdown
from hilserver.errors import FailedError
from tests.benchmarks.test_diagnose import arguments

CASE = next(singles(1, names=("time_constant",)))


def test_a_single_cause_is_fitted_beside_the_diagnosis(monkeypatch):
    case = replace(CASE, recipe=replace(CASE.recipe, duration_s=12.0))
    found = {
        "key": case.key,
        "values": {},
        "outcome": "missed",
        "found": [],
        "wrong": [],
    }
    monkeypatch.setattr(
        diagnose_worker, "_findings", lambda *_: SimpleNamespace(total_gain={})
    )
    monkeypatch.setattr(
        diagnose_worker, "score", lambda *_: diagnose_worker.Score("missed")
    )
    record = diagnose_worker.work(case, with_rivals=True) | found
    value = record["sysid"]["time_constant"]
    assert value["fitted"] == pytest.approx(value["true"], rel=0.05)
    assert value["within_20"]
    table = markdown([record], [])
    assert "| mujoco.sysid: within 20 % | 100.0 % (1 of 1) |" in table
    assert "of 1 |\n" in table


def test_without_the_extra_one_sentence_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(FailedError, match=r"pip install 'hilserver\[rivals\]'"):
        diagnose.run(arguments(tmp_path, words=["--rivals"]))


def test_nothing_is_fitted_that_the_log_cannot_show():
    """Outliers have no column in the replay."""
    case = next(singles(1, names=("nav_outliers",)))
    recipe = replace(case.recipe, duration_s=12.0)
    log = diagnose_worker.measured(make(recipe)[0])
    assert sysid.fitted(case, log, diagnose_worker._engine()[1].robot) == {}

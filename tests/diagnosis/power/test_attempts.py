"""Which effects are tried, what counts as found, and what is said of it."""

import json
import pickle
from pathlib import Path

import pytest
from hilserver_injector import make

from hilserver.diagnosis.catalogue.library import drive_candidates, pose_candidates
from hilserver.diagnosis.output import TRIED
from hilserver.diagnosis.pipeline import Task
from hilserver.diagnosis.power import attempts as tried
from hilserver.diagnosis.power.attempts import (
    TIMES_SMALLEST,
    Attempt,
    AttemptOutcome,
    attempted,
    attempts_of,
    outcome_of,
    until,
)
from hilserver.diagnosis.power.table import files_of, lines_of, rows_of
from hilserver.diagnosis.schema.findings import Detectable
from tests.diagnosis.hidden.logs import recipe

TASK = Task((Path("a.csv"),), None)
CONTROL = AttemptOutcome(
    found=(("named", ("gyro_bias",)),),
    smallest=(
        Detectable(cause="body_lag", size=0.05, unit="s"),
        Detectable(cause="gyro_bias", size=0.001, unit="rad/s"),
        Detectable(cause="rotation_gain", size=0.01, unit="1"),
    ),
)


@pytest.fixture
def library(monkeypatch):
    found = {f"pose: {one.label}": one for one in pose_candidates(None)}
    monkeypatch.setattr(tried, "possible", lambda _task: found)


def test_each_cause_that_is_not_there_yet_is_tried_at_each_size(library):
    found = attempts_of(TASK, CONTROL)
    causes = [one.cause for one in found]
    assert causes[:2] == ["body_lag", "rotation_gain"], "all causes before other sizes"
    assert len(found) == 2 * len(TIMES_SMALLEST)
    lags = [one for one in found if one.cause == "body_lag"]
    assert all(one.value == pytest.approx(one.size) for one in lags), "never negative"
    turns = [one for one in found if one.cause == "rotation_gain"]
    assert all(abs(one.value) == pytest.approx(one.size) for one in turns)
    asked = attempts_of(TASK, CONTROL, ["gyro_bias", "body_lag"])
    assert [one.cause for one in asked] == ["body_lag"] * len(TIMES_SMALLEST)


def test_a_smaller_limit_is_a_larger_effect(monkeypatch):
    limit = next(one for one in drive_candidates() if one.is_limit)
    monkeypatch.setattr(tried, "possible", lambda _task: {"drive: it": limit})
    size = limit.start[0]
    smallest = (Detectable(cause=limit.cause, size=size, unit="rpm/s"),)
    found = attempts_of(TASK, AttemptOutcome(smallest=smallest))
    assert len(found) > 2
    for one in found:
        assert one.size == one.value == pytest.approx(size / one.times)


@pytest.mark.parametrize(
    ("found", "outcome", "wrong"),
    [
        ((), "nothing", ()),
        ((("named", ("gyro_bias",)),), "nothing", ()),
        ((("named", ("body_lag",)),), "named", ()),
        ((("named_group", ("yaw_latency", "body_lag")),), "group", ()),
        ((("data_fault", ("body_lag",)),), "named", ()),
        ((("effective", ("body_lag",)),), "seen", ()),
        ((("named", ("yaw_latency",)),), "seen", ("yaw_latency",)),
        (
            (("named", ("body_lag",)), ("named", ("side_slip",))),
            "named",
            ("side_slip",),
        ),
    ],
)
def test_what_counts_as_found(found, outcome, wrong):
    attempt = Attempt(TASK, "pose: body_lag", "body_lag", "s")
    assert outcome_of(attempt, AttemptOutcome(found), CONTROL) == (outcome, wrong)
    failed = AttemptOutcome(error="a.csv: is gone")
    assert outcome_of(attempt, failed, CONTROL) == ("failed", ())


def test_what_is_tried_travels_to_other_processes(library):
    attempts = attempts_of(TASK, CONTROL)
    assert pickle.loads(pickle.dumps(attempts)) == attempts
    assert pickle.loads(pickle.dumps(CONTROL)) == CONTROL


def test_the_larger_an_effect_the_more_probable_is_its_name():
    powers = [
        Attempt(TASK, "", times=times).predicted for times in sorted(TIMES_SMALLEST)
    ]
    assert powers == sorted(powers)
    assert powers[0] < 0.1
    assert powers[-1] > 0.99


def test_nothing_begins_when_the_time_is_over():
    now = iter([0.0, 10.0, 70.0])
    results = [(number, AttemptOutcome()) for number in range(5)]
    kept = until(results, 60.0, lambda: next(now))
    assert [index for index, _ in kept] == [0, 1]


def test_files_and_table_say_that_this_is_power_and_no_proof(library):
    attempts = attempts_of(TASK, CONTROL)
    named = AttemptOutcome((("named", ("body_lag",)), ("named", ("side_slip",))))
    rows = rows_of(attempts, {0: named, 1: AttemptOutcome()}, CONTROL)
    files = files_of(rows, len(attempts))
    whole = json.loads(files[TRIED[1]])
    assert whole["says"].startswith("Power, no proof")
    assert [one["outcome"] for one in whole["attempts"]] == ["named", "nothing"]
    head, first, _ = files[TRIED[0]].splitlines()
    assert head.startswith("cause,unit,smallest_detectable,size")
    assert first.startswith("body_lag,s,0.05,0.05")
    lines = lines_of(rows, len(attempts))
    assert any(line.startswith("body_lag") and "side_slip" in line for line in lines)
    assert f"2 of {len(attempts)} tried" in lines[-2]

    group = AttemptOutcome((("named_group", ("body_lag", "yaw_latency")),))
    counted = lines_of(rows_of(attempts, {0: named, 2: group}, CONTROL), 2)[-2]
    assert "named in 1, in a group in 1; " in counted
    assert lines_of([], 0) == ["No effect could be tried on this recording."]


def test_a_large_effect_is_found_in_a_recording_without_any(tmp_path):
    path = tmp_path / "log.csv"
    make(recipe("nothing drive", 3, 40.0))[0].write_csv(path)
    task = Task((path,), None)
    label = "pose: rotation_gain"
    attempt = Attempt(task, label, "rotation_gain", "1", value=0.1)
    found = attempted(attempt)
    assert outcome_of(attempt, found, AttemptOutcome()) == ("named", ())
    gone = attempted(Attempt(Task((tmp_path / "none.csv",), None), ""))
    assert "none.csv" in gone.error

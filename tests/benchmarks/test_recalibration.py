"""The bench of recalibration: its robots, its file of results, and what it counts as right."""

import argparse
import json
import sys
from pathlib import Path

import pytest

from benchmarks import recalibration, recalibration_robot, recalibration_wake
from benchmarks.recalibration import add_arguments, cases, is_right, run, table
from benchmarks.recalibration_robot import Case, Drive
from hilserver.bench.jitter_subjects import Place
from hilserver.config.recalibration import RecalibrationConfig
from hilserver.errors import FailedError
from hilserver.recalibration.orders import JudgeResult, Looked, ModelsCompared
from hilserver.recalibration.proposals import ProposedTerm, Quantity
from tests.loopback.rig import wait_until

HIDDEN = {"rotation_gain": -0.03}
TERM = ProposedTerm(-0.031, "1", (-0.033, -0.029))
NAMED = Looked(
    "named", "It turns too little.", ("rotation_gain",), {"rotation_gain": TERM}
)
GAIN = {"yaw_rad": Quantity(0.06, 0.01, 6.0, (4.0, 8.0))}
BETTER = ModelsCompared(1e-6, 1e-6, 72, GAIN)


def arguments(*words):
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return parser.parse_args(words)


@pytest.fixture
def looks(monkeypatch):
    """Every look names the same cause and confirms it; the number of looks is counted."""
    asked = []

    class Judge:
        def __init__(self, order):
            self._todo = order.todo
            asked.append(order.todo)

        def result(self):
            confirm, measure = self._todo.confirm, self._todo.measure
            is_new = confirm is None and not self._todo.loaded
            return JudgeResult(
                measure=None if measure is None else BETTER,
                confirm=None if confirm is None else BETTER,
                look=NAMED if is_new else Looked("as_running"),
            )

    monkeypatch.setattr(recalibration_robot, "OrderJudge", Judge)
    return asked


def test_a_robot_is_looked_at_in_every_window_and_every_proposal_is_accepted(looks):
    case = Case("kinds", "rotation_gain", (Drive(4, HIDDEN),), 10.0, 1, HIDDEN, 1)
    outcome = recalibration_robot.run(case)
    assert [todo.window for todo in looks] == [1, 2, 3, 4]
    assert [p["window"] for p in outcome.proposed] == [2]
    assert outcome.loaded == {"rotation_gain": -0.031}
    assert outcome.effects == {1: [6.0]}


def test_who_stops_goes_on(looks, tmp_path, monkeypatch):
    file = tmp_path / "results.jsonl"
    words = [
        "--rows",
        "null",
        "--nulls",
        "20",
        "--null-window-s",
        "5",
        "--resume",
        str(file),
    ]
    run(arguments(*words, "--jobs", "1"))
    lines = file.read_text().splitlines()
    assert len(lines) == 2
    file.write_text(lines[0] + "\n" + lines[1][:40])  # somebody pulled the plug
    looks.clear()
    rows = {r.name: r for r in run(arguments(*words, "--jobs", "1"))}
    assert len(looks) == 10
    assert rows["proposals without a change"].unit.startswith("of ")
    monkeypatch.setattr(recalibration, "sources", lambda *_: "other")
    looks.clear()
    run(arguments(*words, "--jobs", "1"))
    assert len(looks) == 20


def test_no_two_robots_share_a_line_or_a_seed():
    made = list(cases(arguments()))
    assert len({case.key for case in made}) == len(made) == 12 + 5 + 100
    assert len({case.seed for case in made}) == len(made)


@pytest.mark.parametrize(
    ("terms", "right"),
    [
        (["rotation_gain"], True),
        (["rotation_gain", "nav_scale"], False),
        (["nav_scale"], False),
        ([], False),
    ],
)
def test_right_is_the_cause_and_nothing_else(terms, right):
    assert is_right("rotation_gain", dict.fromkeys(terms)) == right
    assert is_right("wheel_radius", dict.fromkeys(["nav_scale"]))  # no drive can tell


def record(window=4, terms=(("rotation_gain", -0.031),), **fields):
    named = {
        name: (value, (value - 0.002, value + 0.002), None) for name, value in terms
    }
    proposed = [{"window": window, "terms": named}] if terms else []
    found = {"row": "kinds", "name": "rotation_gain", "hidden": HIDDEN, "appears": 2}
    found |= {"proposed": proposed, "effects": {"1": [6.0, 2.0]}, "loaded": {}}
    return json.loads(json.dumps(found | {"looks": [], "confirmations": []} | fields))


def test_late_wrong_and_missing_proposals_are_no_right_ones():
    wrong = (("nav_scale", 0.1),)
    rows = {
        r.name: r
        for r in table([record(), record(5), record(3, wrong), record(terms=())])
    }
    assert rows["right within three windows"].value == 1
    assert rows["robots with a wrong proposal"].raw == ["rotation_gain"]
    assert rows["gap before by after, median"].value == 4.0
    assert rows["error of the size, median"].value == pytest.approx(100 / 30)
    assert rows["intervals that hold the size"].value == 1


def test_the_rate_of_false_proposals_has_its_interval():
    looks = ["nothing"] * 198 + ["named", "data_fault"]
    one = record(
        terms=(),
        row="null",
        looks=looks,
        confirmations=["not_confirmed"],
        window_s=120.0,
    )
    rows = {r.name: r for r in table([one])}
    assert rows["proposals without a change"].value == 0
    assert rows["named without a change"].unit == "of 200"
    level = 1 / 200 * 0.01
    assert rows["false a year, extrapolated"].value == pytest.approx(
        level / 0.01**2, rel=1e-6
    )
    assert (
        rows["its upper end of 95 %"].value > rows["false a year, extrapolated"].value
    )
    assert rows["other verdicts"].raw == {"data_fault": 1}


def test_what_is_left_at_the_end_is_not_taken_back():
    both = record().pop("proposed") * 2
    done, left = (
        record(row="back", proposed=both, loaded=left) for left in ({}, HIDDEN)
    )
    (row,) = table([done, left])
    assert (row.value, row.reference) == (1, 2)


@pytest.fixture
def verdicts(monkeypatch, tmp_path):
    """The process of the looks says what the test wants, again and again."""

    def say(*lines):
        script = f"for line in {lines!r}: print(line, flush=True)\nwhile 1: pass"
        monkeypatch.setattr(
            recalibration_wake, "python", lambda *_: [sys.executable, "-c", script]
        )
        return Place(tmp_path, 1000)

    return say


def state_of(looks):
    stat = Path(f"/proc/{looks._process.pid}/stat").read_text(encoding="utf-8")
    return stat.rpartition(")")[2].split()[0]


async def test_looks_rest_while_a_block_without_one_is_measured(verdicts):
    looks = recalibration_wake.Looks()
    with looks.busy(verdicts("named", "named")):
        looks.say("rest")
        await wait_until(lambda: state_of(looks) == "T")
        looks.say("change")
        await wait_until(lambda: state_of(looks) != "T")
        looks.say("rest")  # the context ends it nevertheless


def test_looks_that_find_nothing_are_no_load(verdicts):
    with (
        pytest.raises(FailedError, match="a look beside the daemon found not_judged"),
        recalibration_wake.Looks().busy(verdicts("not_judged")),
    ):
        pass


def test_a_look_beside_the_daemon_has_the_share_that_is_shipped(tmp_path):
    made = recalibration_wake.Looks.order(Place(tmp_path, 1000))
    assert made.share.nice == RecalibrationConfig().nice
    assert Path(made.path).is_file()

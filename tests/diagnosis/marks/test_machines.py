"""Machines of known dimensions, judged by marks of 2 cm: names, intervals and silence."""

import re
from dataclasses import replace

import numpy as np
import pytest

from hilserver.diagnosis.marks.judging import judge_marks
from hilserver.measured.machine import machine
from hilserver.measured.marks import with_marks
from hilserver.plant.parameters import RobotParameters
from tests.diagnosis.marks.machines import Machine, Tape, squares

TAPES = {
    "line": Tape(),
    "line at both ends": Tape(end_yaw=True),
    "back on the mark": Tape(back=True),
}
SLIPS_M = {"grippy": 1e-5, "slippery": 1e-4}


def judged(folder, robot, tape, seed, runs=30):
    log, text = squares(robot, tape, seed, runs)
    path = folder / "marks.yaml"
    path.write_text(text)
    log = with_marks(log, path)
    plant = machine(log, RobotParameters())
    return judge_marks(log, plant, {}, np.random.default_rng(0), lambda *_: None)


def drawn(number, rng):
    """Return a machine with one or two wrong dimensions, and their sizes."""
    unequal = rng.choice([-1.0, 1.0]) * rng.uniform(0.006, 0.03)
    turns = rng.choice([-1.0, 1.0]) * rng.uniform(0.02, 0.06)
    one, track = Machine.unequal(unequal), 1.0 / (1.0 + turns)
    return (
        (one, {"wheel_radius_difference": unequal}),
        (Machine(track=track), {"rotation_gain": turns}),
        (Machine(1.0 + turns, 1.0 + turns), {"wheel_radius": turns}),
        (
            replace(one, track=track),
            {"wheel_radius_difference": unequal, "rotation_gain": turns},
        ),
    )[number % 4]


class Score:
    """What became of the causes of many machines."""

    def __init__(self):
        self.shown = self.named = self.wrong = self.inside = self.intervals = 0

    def add(self, found, truth):
        smallest = {one.cause: one.size for one in found.smallest}
        by_cause = {cause: one for one in found.findings for cause in one.causes}
        for cause, size in truth.items():
            # of two that look alike, the smallest size is stated for one
            could = cause in by_cause or smallest.get(cause, np.inf) <= abs(size)
            self.shown += could
            self.named += could and cause in by_cause
            if cause in by_cause:
                low, high = by_cause[cause].parameters[cause].ci95
                self.intervals += 1
                self.inside += low <= size <= high
        self.wrong += sum(truth.keys().isdisjoint(f.causes) for f in found.findings)

    def __str__(self):
        return (
            f"named {self.named} of {self.shown}, {self.wrong} wrong, truth in"
            f" {self.inside} of {self.intervals} intervals"
        )


def test_two_machines_and_a_sound_one(tmp_path):
    rng, score, tape = np.random.default_rng(1), Score(), Tape(sd_m=0.005)
    for number in (2, 3):
        robot, truth = drawn(number, rng)
        score.add(judged(tmp_path, robot, tape, number, runs=10), truth)
    assert (score.shown, score.named, score.wrong, score.inside) == (3, 3, 0, 3), score
    assert not judged(tmp_path, Machine(), tape, 9, runs=10).findings


@pytest.mark.long
@pytest.mark.parametrize("slip", SLIPS_M)
@pytest.mark.parametrize("tape", TAPES)
def test_many_machines(tmp_path, tape, slip):
    rng, score = np.random.default_rng(2), Score()
    for number in range(30):
        robot, truth = drawn(number, rng)
        robot = replace(robot, slip_m=SLIPS_M[slip])
        score.add(judged(tmp_path, robot, TAPES[tape], number), truth)
    print(f"{tape}, {slip}: {score}")
    assert score.wrong == 0, score
    assert score.shown >= 20
    assert score.named >= 0.9 * score.shown, score
    assert score.inside >= 0.88 * score.intervals, score


@pytest.mark.long
@pytest.mark.parametrize("slip", SLIPS_M)
@pytest.mark.parametrize("tape", TAPES)
def test_many_sound_machines(tmp_path, tape, slip):
    robot = Machine(slip_m=SLIPS_M[slip])
    found = [judged(tmp_path, robot, TAPES[tape], 1000 + n) for n in range(100)]
    assert sum(bool(one.findings) for one in found) == 0


def test_where_a_run_ended_says_nothing_without_a_direction(tmp_path):
    robot = Machine.unequal(0.02, slip_m=1e-5)
    found = judged(tmp_path, robot, Tape(start_yaw=False), 1, runs=12)
    assert found.findings == found.smallest == ()
    assert any("in which direction" in notice for notice in found.notices)


def test_the_length_of_a_side_tells_a_wheel_radius_from_a_track(tmp_path):
    tape = Tape(sd_m=0.003, side=True)
    for robot, cause in (
        (Machine(1.02, 1.02), "wheel_radius"),
        (Machine(track=1 / 1.02), "rotation_gain"),
    ):
        found = judged(tmp_path, robot, tape, 1, runs=8)
        assert [f.causes for f in found.findings] == [(cause,)]
        low, high = found.findings[0].parameters[cause].ci95
        assert low < 0.02 < high


def test_marks_that_show_nothing_give_a_reason(tmp_path):
    found = judged(tmp_path, Machine(track=1.01), Tape(sd_m=3.0), 1, runs=8)
    assert found.findings == found.smallest == ()
    assert "cannot show it" in found.reasons["rotation_gain"]


def test_slip_grows_with_the_distance_and_widens_intervals(tmp_path):
    """The same marks on a slippery floor say less."""
    sizes = []
    for slip_m in (1e-6, 3e-4):
        found = judged(tmp_path, Machine(slip_m=slip_m), Tape(), 5, runs=12)
        sizes.append({one.cause: one.size for one in found.smallest})
    grippy, slippery = (one["wheel_radius_difference"] for one in sizes)
    assert slippery > 2.0 * grippy


def judged_by(folder, robot, change, runs=8, **tape):
    """Return what is judged where somebody writes wrong marks."""
    log, text = squares(robot, Tape(sd_m=0.005, **tape), 1, runs)
    path = folder / "marks.yaml"
    path.write_text(change(text))
    log = with_marks(log, path)
    plant = machine(log, RobotParameters())
    return judge_marks(log, plant, {}, np.random.default_rng(0), lambda *_: None)


TURNS_LESS = Machine(track=1.05, slip_m=1e-6)


def mirrored(text):
    """Return marks measured to the wrong side of the line."""
    text = re.sub("(y_m|yaw_rad): ", r"\1: -", text)
    return text.replace("--", "")


def in_cm(text):
    return re.sub(
        r"(x_m|y_m): (-?[\d.]+)", lambda m: f"{m[1]}: {100 * float(m[2])}", text
    )


@pytest.mark.parametrize("wrong", [mirrored, in_cm])
def test_marks_that_no_dimension_explains_name_no_cause(tmp_path, wrong):
    found = judged_by(tmp_path, TURNS_LESS, wrong)
    assert found.findings == found.fitted == found.smallest == ()
    assert "no dimension explains" in found.reasons["rotation_gain"]
    assert any("m from their marks" in notice for notice in found.notices)


def test_a_wrong_mark_is_named_by_its_run(tmp_path):
    def exchanged(text):
        lines = text.splitlines()
        last = next(i for i, line in enumerate(lines) if "t_s: 5000.0" in line) + 1
        lines[last] = lines[last].replace("x_m", "z").replace("y_m", "x_m")
        lines[last] = lines[last].replace("z:", "y_m:")
        return "\n".join(lines)

    found = judged_by(tmp_path, TURNS_LESS, exchanged)
    unlike = [n for n in found.notices if "does not fit" in n]
    assert len(unlike) == 1
    assert unlike[0].startswith("segment 5 ")
    assert any("rotation_gain" in f.causes for f in found.findings)
    sound = judged_by(tmp_path, TURNS_LESS, str)
    assert not any("does not fit" in n for n in sound.notices)


def test_marks_less_exact_than_stated_say_by_how_much(tmp_path):
    log, text = squares(TURNS_LESS, Tape(sd_m=0.06), 1, runs=8)
    path = tmp_path / "marks.yaml"
    for stated, is_said in ((0.06, False), (0.005, True)):
        path.write_text(text.replace("sd_m: 0.06", f"sd_m: {stated}"))
        marked = with_marks(log, path)
        plant = machine(marked, RobotParameters())
        rng = np.random.default_rng(0)
        found = judge_marks(marked, plant, {}, rng, lambda *_: None)
        assert found.findings
        said = [n for n in found.notices if "times the" in n]
        assert bool(said) is is_said, found.notices


def test_the_headline_and_the_plot_say_how_far_a_tape_reaches(tmp_path):
    found = judged_by(tmp_path, TURNS_LESS, str)
    gain = found.gain["position_m"]
    simulated, extended = (
        float(np.hypot(*ends.T).mean())
        for ends in (found.ends.simulated, found.ends.extended)
    )
    assert gain.before == pytest.approx(simulated)
    assert gain.after == pytest.approx(extended, rel=0.5)

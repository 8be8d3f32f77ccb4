"""Squares whose start and end alone are known; the robot is computed here, without the plant."""

import re
from pathlib import Path

import numpy as np
import pytest

from hilserver.config.root import load_config
from hilserver.diagnosis.engine import judge
from hilserver.diagnosis.schema.findings import Overall
from hilserver.errors import LogError
from hilserver.measured.floor_marks import FloorMark
from hilserver.measured.frames import Sampling
from hilserver.measured.marks import with_marks
from hilserver.measured.reading import read_measured
from hilserver.plant.parameters import RobotParameters
from tests.diagnosis.marks.machines import Machine, Tape, squares

TAPE = Tape(sd_m=0.004, yaw_sd_rad=0.004)
RUNS = 8


def diagnosed(tmp_path, seed=1, **robot):
    log, text = squares(Machine(**robot), TAPE, seed, RUNS)
    path = tmp_path / "marks.yaml"
    path.write_text(text)
    return judge(with_marks(log, path), RobotParameters(), jobs=1).findings


def test_start_and_end_of_squares_show_unequal_wheels(tmp_path):
    found = diagnosed(tmp_path, left_radius=0.99, right_radius=1.01)
    assert [f.causes for f in found.findings] == [("wheel_radius_difference",)]
    difference = found.findings[0].parameters["wheel_radius_difference"]
    assert difference.value == pytest.approx(-0.02, abs=0.002)
    assert difference.ci95[0] < -0.02 < difference.ci95[1]
    assert found.total_gain["position_m"].ratio > 2.0
    assert any("Marks show" in notice for notice in found.notices)
    reasons = {n.cause: n.reason for n in found.not_judged}
    assert "marks say where" in reasons["yaw_latency"]


def test_a_wider_track_is_among_what_the_marks_leave_possible(tmp_path):
    found = diagnosed(tmp_path, track=1.03)
    assert len(found.findings) == 1
    assert "rotation_gain" in found.findings[0].causes
    assert "wheel_radius_difference" not in found.findings[0].causes
    assert "forward_m" in found.findings[0].separating_experiment


@pytest.mark.parametrize("seed", range(3))
def test_a_sound_robot_gives_no_finding(tmp_path, seed):
    found = diagnosed(tmp_path, seed=seed)
    assert found.findings == ()
    assert "wheel_radius_difference" in {d.cause for d in found.smallest_detectable}


@pytest.mark.parametrize(("difference", "turns"), [(0.02, 0.0), (0.01, -0.03)])
def test_squares_that_wrong_wheels_bend_by_half_their_side(tmp_path, difference, turns):
    robot = Machine.unequal(difference, track=1.0 / (1.0 + turns), slip_m=1e-5)
    log, text = squares(robot, TAPE, 1, RUNS, side_m=2.0)
    path = tmp_path / "marks.yaml"
    path.write_text(text)
    found = judge(with_marks(log, path), RobotParameters(), jobs=1).findings
    sizes = {"wheel_radius_difference": difference, "rotation_gain": turns}
    values = {n: p for one in found.findings for n, p in one.parameters.items()}
    for cause, size in sizes.items():
        if size:
            low, high = values[cause].ci95
            assert low < size < high, values
    assert found.verdict is Overall.FINDINGS


@pytest.mark.parametrize("size", [0.05, 0.3, 0.6])
def test_a_robot_far_from_its_configuration_is_never_sound(tmp_path, size):
    found = diagnosed(tmp_path, left_radius=1.0 - size / 2, right_radius=1.0 + size / 2)
    if not found.findings:
        assert found.verdict is Overall.NOT_JUDGED
        assert any("from their marks" in notice for notice in found.notices)


@pytest.mark.parametrize(
    ("marks", "says"),
    [
        ("{t_s: 9999, x_m: 0, y_m: 0, sd_m: 0.1}", "is in no run of the log"),
        ("{t_s: 1, x_m: 0, sd_m: 0.1}", "x_m and y_m belong together"),
        ("{t_s: 1, sd_m: 0.1}", "exactly one of"),
        ("{t_s: 1, same_as_t_s: 1, sd_m: 0.1}", "refers to its own time"),
        ("{t_s: 1, from_t_s: 101, forward_m: 4, sd_m: 0.1}", "outside its run"),
        ("{t_s: 1, x_m: 0, y_m: 0, segment: 77, sd_m: 0.1}", "segment 77 is not"),
    ],
)
def test_a_wrong_mark_is_one_sentence_with_its_line(tmp_path, marks, says):
    path = tmp_path / "marks.yaml"
    path.write_text(f"marks:\n  - {marks}\n")
    with pytest.raises(LogError, match=f"marks.yaml:2: .*{says}"):
        with_marks(squares(Machine(), TAPE, 1, RUNS)[0], path)


def test_a_mark_until_the_next_row_would_have_come_is_of_its_run(tmp_path):
    log, _ = squares(Machine(), TAPE, 1, RUNS)
    last_s = log.spans[1].end_s
    file = tmp_path / "marks.yaml"
    for t_s, is_taken in ((last_s + 0.02, True), (last_s + 0.2, False)):
        file.write_text(f"marks: [{{t_s: {t_s}, x_m: 0, y_m: 0, sd_m: 0.01}}]\n")
        if is_taken:
            assert [placed.span for placed in with_marks(log, file).marks] == [1]
            continue
        with pytest.raises(LogError, match="is in no run"):
            with_marks(log, file)


def test_a_segment_is_that_of_the_log_also_where_a_pause_cuts_it(tmp_path):
    rows = ["t_s,segment,wheel.fl.speed_rpm,wheel.fr.speed_rpm"]
    for segment in (0, 1):
        times_s = np.arange(0.0, 60.0, 0.1)
        if segment == 0:  # the recorder pauses
            times_s = times_s[(times_s < 20.0) | (times_s > 30.0)]
        rows += [f"{t_s:.1f},{segment},20.0,-20.0" for t_s in times_s]
    (tmp_path / "log.csv").write_text("\n".join(rows) + "\n")
    log = read_measured([tmp_path / "log.csv"], None, Sampling.of(load_config(None)))
    assert len(log.spans) == 3
    file = tmp_path / "marks.yaml"
    for t_s, segment, span in ((40.0, 1, 2), (2.0, 1, 2), (40.0, 0, 1)):
        mark = f"{{t_s: {t_s}, segment: {segment}, x_m: 0, y_m: 0, sd_m: 0.01}}"
        file.write_text(f"marks: [{mark}]\n")
        assert [placed.span for placed in with_marks(log, file).marks] == [span]


@pytest.mark.parametrize(("sd_m", "is_asked"), [(0.05, False), (5, True)])
def test_a_deviation_of_metres_is_asked_about(tmp_path, sd_m, is_asked):
    path = tmp_path / "marks.yaml"
    path.write_text(f"marks: [{{t_s: 1, x_m: 0, y_m: 0, sd_m: {sd_m}}}]\n")
    log = with_marks(squares(Machine(), TAPE, 1, RUNS)[0], path)
    asked = [note for note in log.notices if "write metres, as 0.005" in note]
    assert bool(asked) is is_asked


def test_a_pose_shows_more_than_marks(tmp_path):
    log, _ = squares(Machine(), TAPE, 1, RUNS)
    posed = log.with_channels({"nav.x_m": log["wheel.fl.speed_rpm"]})
    with pytest.raises(LogError, match="has a pose of its own"):
        with_marks(posed, tmp_path / "marks.yaml")


def test_the_documentation_has_all_keys_of_a_mark():
    text = (Path(__file__).parents[3] / "docs" / "how-to" / "marks.md").read_text()
    table = text[text.index("| key |") : text.index("A mark has exactly")]
    assert set(re.findall("`([a-z_]+)`", table)) == set(FloorMark.model_fields)

"""Squares whose start and end alone are known; the robot is computed here, without the plant."""

import numpy as np
import pytest

from hilserver.diagnosis.engine import judge
from hilserver.errors import LogError
from hilserver.measured.data import Channel, LogSource, MeasuredLog, Span
from hilserver.measured.marks import with_marks
from hilserver.plant.parameters import RobotParameters

RADIUS_M, TRACK_M, RUNS, SIDE_S = 0.042, 0.2, 8, 3.0
PERIOD_S = 0.05
PLANT = {
    "wheel_radius_m": RADIUS_M, "track_m": TRACK_M, "max_rpm": 200, "wheelbase_m": None,
    "drive": "skid", "icr_offset_m": 0.0, "rotation_gain": "geometric_diff",
}  # fmt: skip


def squares(left_radius=1.0, right_radius=1.0, track=1.0, seed=1):
    """Return a log of squares in both directions, and the text of a file of their marks."""
    rng = np.random.default_rng(seed)
    stamps, lefts, rights, number, spans, lines = [], [], [], [], [], ["marks:"]
    for run in range(RUNS):
        way = 1.0 if run % 2 else -1.0
        turn_rad_s = 0.25 * np.pi * TRACK_M / RADIUS_M * way
        straight, turn = [np.full(60, 6.0)] * 2, [np.full(40, -turn_rad_s / 2)] * 2
        turn[1] = -turn[0]
        pause = np.zeros(4)
        left, right = (
            np.concatenate([pause, *[straight[k], pause, turn[k], pause] * 4])
            for k in (0, 1)
        )
        t_s = 100.0 * run + PERIOD_S * np.arange(len(left))

        # speeds change linearly between rows, so the trapezoid is exact for the heading
        v = RADIUS_M * (right_radius * right + left_radius * left) / 2
        om = RADIUS_M * (right_radius * right - left_radius * left) / (TRACK_M * track)
        fine = np.arange(t_s[0], t_s[-1], 0.001)
        v, om = np.interp(fine, t_s, v), np.interp(fine, t_s, om)
        yaw = np.concatenate([[0.0], np.cumsum((om[1:] + om[:-1]) * 0.0005)])
        place = np.cumsum(v * np.exp(1j * yaw)) * 0.001
        x, y = np.array([place[-1].real, place[-1].imag]) + rng.normal(0.0, 0.005, 2)
        lines += [
            f"  - {{t_s: {t_s[0]}, x_m: 0, y_m: 0, yaw_rad: 0, sd_m: 0.001, yaw_sd_rad: 0.002}}",
            f"  - {{t_s: {t_s[-1] - 0.01}, x_m: {x}, y_m: {y}, sd_m: 0.005}}",
        ]
        stamps.append(t_s)
        lefts.append(left)
        rights.append(right)
        number.append(np.full(len(t_s), run))
        spans.append(Span(run, None, float(t_s[0]), float(t_s[-1])))

    t_s, span = np.concatenate(stamps), np.concatenate(number)
    rpm = 30.0 / np.pi
    channels = {
        f"wheel.{wheel}.speed_rpm": Channel(t_s, rpm * sign * np.concatenate(speeds), span)
        for wheel, speeds, sign in (
            ("fl", lefts, 1), ("rl", lefts, 1), ("fr", rights, -1), ("rr", rights, -1)
        )
    }  # fmt: skip
    log = MeasuredLog(
        (LogSource("squares.csv", "0" * 64),), channels, tuple(spans), plant=PLANT
    )
    return log, "\n".join(lines) + "\n"


def diagnosed(tmp_path, **robot):
    log, text = squares(**robot)
    path = tmp_path / "marks.yaml"
    path.write_text(text)
    return judge(with_marks(log, path), RobotParameters(), jobs=1).findings


def test_start_and_end_of_squares_show_unequal_wheels(tmp_path):
    found = diagnosed(tmp_path, left_radius=0.99, right_radius=1.01)
    assert [f.causes for f in found.findings] == [("wheel_radius_difference",)]
    difference = found.findings[0].parameters["wheel_radius_difference"]
    assert difference.value == pytest.approx(-0.02, abs=0.001)
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


@pytest.mark.parametrize("seed", range(3))
def test_a_sound_robot_gives_no_finding(tmp_path, seed):
    found = diagnosed(tmp_path, seed=seed)
    assert found.findings == ()
    assert "wheel_radius_difference" in {d.cause for d in found.smallest_detectable}


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
        with_marks(squares()[0], path)


def test_a_pose_shows_more_than_marks(tmp_path):
    log, _ = squares()
    posed = log.with_channels({"nav.x_m": log["wheel.fl.speed_rpm"]})
    with pytest.raises(LogError, match="has a pose of its own"):
        with_marks(posed, tmp_path / "marks.yaml")

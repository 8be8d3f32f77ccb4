"""Logs of others: their set-points hold until the next row, from a fresh start."""

import numpy as np
import pytest

from hilserver.logs import read_log
from hilserver.plant.layout import WHEELS
from tests.measured.samples import write_bag

HEADER = ",".join(["t_s", *(f"wheel.{w}.setpoint_rpm" for w in WHEELS)])


def write_steps(path, rows, header=HEADER):
    lines = [header, *(",".join(map(str, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_set_points_at_50_hz_hold_until_the_next_row(replay_here, tmp_path):
    rows = [(i * 0.02, 10 + i, 10 + i, -10 - i, -10 - i) for i in range(50)]
    log = write_steps(tmp_path / "log.csv", rows)
    text = replay_here(log, "-o", "out.csv")
    assert "replayed 981 ticks (0.981 s)" in text
    out = read_log(tmp_path / "out.csv")
    expected = [10 + tick // 20 for tick in range(981)]
    assert out.columns["wheel.fl.setpoint_rpm"].tolist() == expected
    assert out.columns["wheel.fl.speed_rpm"][-1] > 20
    assert out.columns["pose.x_m"][-1] > 0.05
    assert set(out.columns["sim.state"].tolist()) == {1.0}


def test_a_row_between_two_ticks_is_latched_by_the_next_one(replay_here, tmp_path):
    log = write_steps(
        tmp_path / "log.csv",
        [(0, 0, 0, 0, 0), (0.0102, 50, 50, -50, -50), (0.02, *"0000")],
    )
    replay_here(log, "-o", "out.csv")
    values = read_log(tmp_path / "out.csv").columns["wheel.fl.setpoint_rpm"]
    assert np.flatnonzero(values).tolist() == list(range(11, 20))


def test_missing_samples_hold_and_segments_start_anew(replay_here, tmp_path):
    rows = [
        (1.0, 5, 40, 40, -40, -40),
        (1.5, 5, "", "nan", "", ""),
        (1.0, 6, 40, 40, -40, -40),
        (1.5, 6, *"    "),
    ]
    header = HEADER.replace("t_s", "t_s,segment")
    log = write_steps(tmp_path / "log.csv", rows, header)
    replay_here(log, "-o", "out.csv")
    assert "bit for bit" in replay_here("out.csv", "-o", "again.mcap", "--check")
    out = read_log(tmp_path / "out.csv")
    assert sorted(set(out.segment.tolist())) == [5, 6]
    first, second = (
        {n: c[out.segment == s] for n, c in out.columns.items()} for s in (5, 6)
    )
    for name in ("pose.x_m", "wheel.rr.speed_rpm", "imu.accel_x_m_s2"):
        assert np.array_equal(first[name], second[name])
    assert first["wheel.fl.setpoint_rpm"].tolist() == [40.0] * 501
    assert out.t_s[0] == 1.0
    assert out.t_s[-1] == 1.5


def test_a_twist_alone_switches_to_twist_mode_and_what_is_too_fast_is_limited(
    replay_here, tmp_path
):
    log = write_steps(
        tmp_path / "log.csv",
        [(0, 0.2, 0.5), (1, 99, 0)],
        "t_s,twist.linear_m_s,twist.angular_rad_s",
    )
    text = replay_here(log, "-o", "out.csv")
    assert "column 'twist.linear_m_s': 1 values outside" in text
    out = read_log(tmp_path / "out.csv")
    assert set(out.columns["control.mode"].tolist()) == {1.0}
    assert out.columns["pose.yaw_rad"][-1] > 0.2


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("t_s,pose.x_m\n0,1\n", "has no column with set-points"),
        (
            "t_s,pose.x\n0,1\n",
            "row 1, column 2 'pose.x': there is no such signal; did you mean",
        ),
        ("t_s,twist.linear_m_s\n0,1\n1e9,1\n", "lasts more than 1000000000 ticks"),
        ("t_s,twist.linear_m_s\n", "contains no rows"),
        (
            "t_s,twist.linear_m_s\n0,0.1\nx,0.1\n",
            "row 3, column 1 't_s': 'x' is not a number",
        ),
    ],
)
def test_what_cannot_be_replayed_is_one_sentence(
    replay_here, tmp_path, text, complaint
):
    (tmp_path / "log.csv").write_text(text)
    said = replay_here("log.csv", "-o", "out.csv", code=2)
    assert complaint in said
    assert len(said.splitlines()) == 1


DUTY = "t_s," + ",".join(f"wheel.{w}.duty_command_pct" for w in WHEELS)
DUTIES = [(0.02 * i, 30, 30, -30, -30) for i in range(51)]


def test_duties_alone_switch_to_duty_mode(replay_here, tmp_path):
    replay_here(write_steps(tmp_path / "log.csv", DUTIES, DUTY), "-o", "out.csv")
    out = read_log(tmp_path / "out.csv")
    assert set(out.columns["control.mode"].tolist()) == {2.0}
    assert out.columns["wheel.fl.speed_rpm"][-1] == pytest.approx(33.3, rel=0.01)


def test_duties_of_a_foreign_table_drive_through_a_mapping(replay_here, tmp_path):
    lines = [f"  {n}: {{column: pwm{k}}}" for k, n in enumerate(DUTY.split(",")[1:])]
    (tmp_path / "map.yaml").write_text("channels:\n" + "\n".join(lines) + "\n")
    log = write_steps(tmp_path / "log.csv", DUTIES, "t_s,pwm0,pwm1,pwm2,pwm3")
    replay_here(log, "--mapping", "map.yaml", "-o", "out.csv")
    assert read_log(tmp_path / "out.csv").columns["wheel.rr.speed_rpm"][-1] < -30


@pytest.mark.parametrize(
    ("header", "row", "complaint"),
    [
        (
            f"{DUTY},wheel.fl.setpoint_rpm",
            "1,1,1,1,5",
            "rr.duty_command_pct without effect",
        ),
        (
            f"{DUTY},control.mode",
            "1,1,1,1,0",
            "none of its columns moves the robot: no set-point",
        ),
        (
            f"{DUTY},drive.enable",
            "1,1,1,1,0",
            "moves the robot: drive.enable is 0 throughout",
        ),
        (
            "t_s,twist.linear_m_s,control.mode",
            "1,0",
            "without effect: control.mode is 0 throughout",
        ),
        (
            "t_s,twist.linear_m_s",
            "",
            "none of its columns moves the robot: no set-point",
        ),
    ],
)
def test_set_points_that_take_no_effect_are_said(
    replay_here, tmp_path, header, row, complaint
):
    text = "".join(f"{0.02 * i},{row}\n" for i in range(20))
    (tmp_path / "log.csv").write_text(f"{header}\n{text}")
    assert complaint in replay_here("log.csv", "-o", "out.csv")


def test_set_points_in_force_are_not_spoken_of(replay_here, tmp_path):
    rows = [(t, *duties, 2 * (t > 0.5), 1) for t, *duties in DUTIES]
    log = write_steps(tmp_path / "log.csv", rows, f"{DUTY},control.mode,drive.enable")
    assert "effect" not in replay_here(log, "-o", "out.csv")


MAPPED = """
plant: {wheel_radius_m: 0.165, track_m: 0.55}
channels:
  twist.linear_m_s: {column: v}
  twist.angular_rad_s: {column: w, unit: deg/s}
"""


def test_a_foreign_table_through_a_mapping_drives_the_machine_that_it_describes(
    replay_here, tmp_path
):
    (tmp_path / "map.yaml").write_text(MAPPED)
    log = write_steps(
        tmp_path / "log.csv", [(7, 0.5, 0), (8, 0.5, 0), (9, 0, 90)], "t_s,v,w"
    )
    assert "replayed 2001 ticks" in replay_here(
        log, "--mapping", "map.yaml", "-o", "out.csv"
    )
    out = read_log(tmp_path / "out.csv")
    assert out.columns["twist.angular_rad_s"][-1] == pytest.approx(np.pi / 2)
    speed = out.columns["wheel.fl.speed_rpm"][1900]
    assert speed * 0.165 * 2 * np.pi / 60 == pytest.approx(0.5, rel=0.01)


def test_a_bag_is_replayed_through_a_mapping(replay_here, tmp_path):
    topic = "{topic: /iotbot/rpm, field: %s}"
    fields = ("front_left_rpm", "rear_left_rpm", "front_right_rpm", "rear_right_rpm")
    lines = [
        f"  wheel.{w}.setpoint_rpm: {topic % f}"
        for w, f in zip(WHEELS, fields, strict=True)
    ]
    (tmp_path / "map.yaml").write_text("channels:\n" + "\n".join(lines) + "\n")
    bag = write_bag(tmp_path / "bag", n=60)
    replay_here(bag, "--mapping", "map.yaml", "-o", "out.csv")
    values = read_log(tmp_path / "out.csv").columns["wheel.rl.setpoint_rpm"]
    assert values[[0, 20, 41]].tolist() == [2.0, 3.0, 4.0]
    assert "needs a mapping of its topics" in replay_here(bag, "-o", "no.csv", code=2)

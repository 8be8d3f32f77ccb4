"""A foreign table without a mapping: its columns are listed and a mapping file is proposed."""

import pytest
import yaml

from hilserver.commands import main
from hilserver.errors import LogError
from hilserver.measured import proposal
from hilserver.measured.mapping import load_mapping
from hilserver.measured.proposal import ForeignLog, Head
from hilserver.measured.reading import read_measured

FOREIGN = "time_ms,left_rad_s,right_rad_s,cmd_left_rpm,cmd_right_rpm,x,y,heading_deg,gyro_z,vbat"


def propose(header, row=()):
    return proposal.propose(Head(header, row))


def write(path, header=FOREIGN):
    rows = [
        f"{20 * i},{','.join(str(k + 0.1 * i) for k in range(9))}" for i in range(120)
    ]
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def test_the_proposal_is_a_mapping_that_reads_the_table(tmp_path):
    (tmp_path / "map.yaml").write_text(propose(FOREIGN.split(",")))
    mapping = load_mapping(tmp_path / "map.yaml")
    assert (mapping.time.column, mapping.time.unit) == ("time_ms", "ms")
    assert {
        name: (c.column, c.unit, c.sign) for name, c in mapping.channels.items()
    } == {
        "wheel.fl.speed_rpm": ("left_rad_s", "rad/s", 1),
        "wheel.rl.speed_rpm": ("left_rad_s", "rad/s", 1),
        "wheel.fr.speed_rpm": ("right_rad_s", "rad/s", -1),
        "wheel.rr.speed_rpm": ("right_rad_s", "rad/s", -1),
        "wheel.fl.setpoint_rpm": ("cmd_left_rpm", None, 1),
        "wheel.rl.setpoint_rpm": ("cmd_left_rpm", None, 1),
        "wheel.fr.setpoint_rpm": ("cmd_right_rpm", None, -1),
        "wheel.rr.setpoint_rpm": ("cmd_right_rpm", None, -1),
        "nav.x_m": ("x", None, 1),
        "nav.y_m": ("y", None, 1),
        "nav.yaw_rad": ("heading_deg", "deg", 1),
        "imu.gyro_z_rad_s": ("gyro_z", None, 1),
        "battery.voltage_v": ("vbat", None, 1),
    }
    log = read_measured([write(tmp_path / "log.csv")], tmp_path / "map.yaml")
    assert log["nav.x_m"].t_s[1] == pytest.approx(0.02)


def test_a_gyroscope_in_degrees_has_its_unit():
    assert "imu.gyro_z_rad_s: {column: gyro_z_dps, unit: deg/s}" in propose(
        ["t_s", "gyro_z_dps"]
    )


@pytest.mark.parametrize(
    ("column", "signals"),
    [
        ("wheelSpeedFL", ["wheel.fl.speed_rpm"]),
        ("rear right pwm", ["wheel.rr.duty_pct"]),
        ("cmd_vel.linear.x", ["twist.linear_m_s"]),
        ("cmd_vel.angular.z", ["twist.angular_rad_s"]),
        ("theta", ["nav.yaw_rad"]),
        ("humidity", []),
        ("left_ticks", ["wheel.fl.angle_rad", "wheel.rl.angle_rad"]),
        ("encoder_count_rl", ["wheel.rl.angle_rad"]),
        ("left_encoder_rad_s", ["wheel.fl.speed_rpm", "wheel.rl.speed_rpm"]),
        ("left_motor_current", []),
        ("wheel_position_fr", ["wheel.fr.angle_rad"]),
    ],
)
def test_names_of_others(column, signals):
    text = propose(["t", column])
    assert [
        line.split(":")[0].strip() for line in text.splitlines() if "{column" in line
    ][1:] == (signals)


def test_diagnose_lists_the_columns_and_writes_the_proposal(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "log.csv")
    assert main(["diagnose", "log.csv", "-o", "out"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "none of the columns 'time_ms', 'left_rad_s'," in line
    assert "--mapping; out/mapping.yaml is a first guess: check and complete it" in line
    assert load_mapping(tmp_path / "out" / "mapping.yaml").channels


def test_a_name_of_ours_that_is_mistyped_is_still_said(tmp_path):
    path = write(tmp_path / "log.csv", f"t_s,wheel.fl.speed,nav.x_m{',a,b,c,d,e,f,g'}")
    with pytest.raises(
        LogError, match="did you mean 'wheel.fl.speed_rpm'".replace(".", "[.]")
    ):
        read_measured([path])


def test_without_a_guess_there_is_no_proposal():
    assert propose(["a", "b"]) == ""


def channels_of(text):
    mapping = yaml.safe_load(text)
    return {name: channel["column"] for name, channel in mapping["channels"].items()}


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (
            ["field.velocity0", "field.velocity1"],
            ("field.velocity0", "field.velocity1"),
        ),
        (["vel[0]", "vel[1]", "vel[2]", "vel[3]"], ("vel[0]", "vel[1]")),
        (["motor1_rpm", "motor2_rpm"], ("motor1_rpm", "motor2_rpm")),
    ],
)
def test_numbered_columns_are_wheels_in_order(names, expected):
    found = channels_of(propose(["time", *names]))
    assert (found["wheel.fl.speed_rpm"], found["wheel.fr.speed_rpm"]) == expected


def test_numbers_that_are_no_wheels_stay_what_they_are():
    found = channels_of(propose(["t", "x1", "x2", "y1"]))
    assert found == {"nav.x_m": "x1", "nav.y_m": "y1"}
    assert propose(["t", "x1", "x2"]) == ""  # half a position is none


def test_the_first_row_names_the_joints_and_the_unit_of_time(tmp_path):
    header = [
        "%time",
        "field.name0",
        "field.name1",
        "field.velocity0",
        "field.velocity1",
    ]
    row = ["1700000000000000000", "right_wheel_joint", "left_wheel_joint", "1.0", "2.0"]
    lines = [header, *([str(int(row[0]) + i * 10**7), *row[1:]] for i in range(200))]
    (tmp_path / "log.csv").write_text("\n".join(map(",".join, lines)) + "\n")
    with pytest.raises(ForeignLog) as error:
        read_measured([tmp_path / "log.csv"])
    (tmp_path / "map.yaml").write_text(error.value.proposal)
    mapping = load_mapping(tmp_path / "map.yaml")
    assert mapping.time.unit == "ns"
    left = mapping.channels["wheel.fl.speed_rpm"]
    assert (left.column, left.unit) == ("field.velocity1", "rad/s")
    assert read_measured([tmp_path / "log.csv"], tmp_path / "map.yaml")[
        "wheel.fr.speed_rpm"
    ]


def test_the_proposal_has_a_plant_and_warns_of_what_it_cannot_know():
    text = propose(
        ["time", "left_ticks", "right", "right_rpm", "odom.x", "odom.y", "tag.yaw"]
    )
    assert yaml.safe_load(text)["plant"] == {}
    assert "plant: {wheel_radius_m: 0.1, track_m: 0.4, wheelbase_m: 0.3}" in text
    said = {
        line.split(":")[0].strip(): line.partition("#")[2] for line in text.splitlines()
    }
    assert "2 pi / counts per revolution" in said["wheel.fl.angle_rad"]
    assert "rpm?" in said["wheel.fr.speed_rpm"]
    assert "computed from the wheel speeds?" in said["nav.x_m"]
    assert said["nav.yaw_rad"] == " by its name"
    assert not said["time"]


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_dates_in_the_first_row_are_proposed_as_such(tmp_path, separator):
    rows = [f"2026-11-25 12:00:{0.02 * i:06.3f},{i}" for i in range(120)]
    path = tmp_path / "log.csv"
    path.write_text(
        "\n".join(["Zeit time,left_rpm", *rows, ""]).replace(",", separator)
    )
    with pytest.raises(ForeignLog) as refusal:
        read_measured([path])
    assert 'time: {column: "Zeit time", unit: iso}' in refusal.value.proposal
    (tmp_path / "map.yaml").write_text(refusal.value.proposal)
    log = read_measured([path], tmp_path / "map.yaml")
    assert log["wheel.fl.speed_rpm"].t_s[-1] == pytest.approx(2.38)

"""`hilserver observe`: a log in, where the robot was out."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hilserver_injector import Recipe, make
from hilserver_injector.recipe import Recorder

from hilserver.commands import main
from hilserver.logs import read_log
from hilserver.measured.names import known_columns

WHEELS = [f"wheel.{wheel}.speed_rpm" for wheel in ("fl", "rl", "fr", "rr")]
FOUND = {
    "schema": "hilserver.diagnosis/2",
    "noise": {
        **{name: {"white_sd": 0.12} for name in WHEELS},
        "imu.gyro_z_rad_s": {"white_sd": 0.006},
        "nav.x_m": {"white_sd": 0.01, "ou_sd": 0.05, "ou_tau_s": 0.6},
        "nav.y_m": {"white_sd": 0.01, "ou_sd": 0.05, "ou_tau_s": 0.6},
        "nav.yaw_rad": {"white_sd": 0.0, "ou_sd": 0.015, "ou_tau_s": 2.0},
    },
    "joint": {"parameters": ["rotation_gain"], "value": [0.0], "covariance": [[1e-6]]},
}


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    path = tmp_path_factory.mktemp("logs") / "run.csv"
    table, truth = make(Recipe(seed=5, duration_s=40.0))
    table.write_csv(path)
    return path, truth.dense


@pytest.fixture
def found(tmp_path):
    path = tmp_path / "findings.json"
    path.write_text(json.dumps(FOUND))
    return path


def errors(path, dense):
    log = read_log(path, known_columns())
    known = log.columns["estimate.state"] > 0
    e = [
        log.columns[f"estimate.{name}"][known]
        - np.interp(log.t_s[known], dense[:, 0], dense[:, k])
        for name, k in (("x_m", 1), ("y_m", 2), ("yaw_rad", 3))
    ]
    e[2] = np.angle(np.exp(1j * e[2]))
    sd = [log.columns[f"estimate.{n}_sd"][known] for n in ("x_m", "y_m", "yaw_rad")]
    return np.array(e), np.array(sd)


@pytest.mark.parametrize("suffix", [".csv", ".mcap"])
def test_the_path_is_near_the_truth_and_the_smoothed_one_nearer(
    drive, found, tmp_path, capsys, suffix
):
    path, dense = drive
    size = []
    for how in ([], ["--smooth"]):
        out = tmp_path / f"out{len(how)}{suffix}"
        words = ["observe", str(path), "--findings", str(found), "-o", str(out), *how]
        assert main(words) == 0
        e, sd = errors(out, dense)
        assert np.hypot(*e[:2]).mean() < 0.04
        assert np.mean((e / sd) ** 2) < 3.0
        size.append(np.hypot(*e[:2]).mean())
        assert "<svg" in out.with_suffix(".svg").read_text()
    assert size[1] < size[0]
    text = capsys.readouterr().out
    assert "navigation samples were used and" in text
    assert "the robot was carried 0 times" in text
    assert text.count("fitted to this log") == 2
    assert "the path from the wheels alone" in text


def test_stamps_that_a_diagnosis_has_found_late_are_put_right(tmp_path):
    table, truth = make(Recipe(seed=5, duration_s=40.0))
    rows, step_s = 20, float(table.t_s[1] - table.t_s[0])
    for name in ("nav.x_m", "nav.y_m", "nav.yaw_rad"):
        table.columns[name][rows:] = table.columns[name][:-rows].copy()
        table.columns[name][:rows] = np.nan
    table.write_csv(tmp_path / "run.csv")
    size = []
    for late_s in (0.0, rows * step_s):
        clock = {
            "verdict": "named",
            "parameters": {"clock_offset.nav": {"value": late_s}},
        }
        findings, out = tmp_path / "findings.json", tmp_path / "out.csv"
        findings.write_text(json.dumps(FOUND | {"findings": [clock]}))
        words = [
            "observe",
            str(tmp_path / "run.csv"),
            "--findings",
            str(findings),
            "-o",
            str(out),
        ]
        assert main(words) == 0
        size.append(np.hypot(*errors(out, truth.dense)[0][:2]).mean())
    assert size[1] < 0.04 < 0.06 < size[0]


def test_a_filter_that_does_not_know_its_robot_says_so_first(drive, tmp_path, capsys):
    """A navigation in millimetres: what it shows is no motion of these wheels."""
    table, _ = make(Recipe(seed=5, duration_s=20.0))
    for name in ("nav.x_m", "nav.y_m"):
        table.columns[name] = table.columns[name] * 1e3
    log, out = tmp_path / "run.csv", tmp_path / "out.csv"
    table.write_csv(log)
    words = ["observe", str(log), "-o", str(out)]
    assert main(words) == 0
    first = capsys.readouterr().out.splitlines()[0]
    assert first.startswith("The squared innovations are ")
    assert "--inflate" in first
    out.unlink()
    assert main([*words, "--smooth"]) == 1
    assert not out.exists()
    said = capsys.readouterr().err
    assert "smoothed path would be no better" in said
    assert "--inflate" in said
    assert main([*words, "--smooth", "--inflate"]) == 0
    first = capsys.readouterr().out.splitlines()[0]
    assert "all variances have been made that much larger" in first
    assert out.exists()


def test_without_a_position_only_speeds_are_known(tmp_path, capsys):
    recorder = Recorder(channels=("speed", "gyro"))
    table, _ = make(replace(Recipe(seed=5, duration_s=20.0), recorder=recorder))
    table.write_csv(tmp_path / "run.csv")
    assert (
        main(["observe", str(tmp_path / "run.csv"), "-o", str(tmp_path / "out.csv")])
        == 0
    )
    assert "No pose is known" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("no json", "is not JSON"),
        ('{"schema": "hilserver.diagnosis/1"}', "run 'hilserver diagnose' again"),
        ("{}", "schema: field required"),
        (
            json.dumps(FOUND | {"noise": {"nav.x_m": {"white_sd": -1}}}),
            "noise.nav.x_m.white_sd",
        ),
        (
            json.dumps(
                FOUND | {"joint": {"parameters": ["a"], "value": [1], "covariance": []}}
            ),
            "1 parameters need 1 rows",
        ),
    ],
)
def test_findings_that_are_none_get_a_sentence(drive, tmp_path, capsys, text, words):
    wrong = tmp_path / "findings.json"
    wrong.write_text(text)
    out = str(tmp_path / "out.csv")
    assert main(["observe", str(drive[0]), "--findings", str(wrong), "-o", out]) == 78
    said = capsys.readouterr().err
    assert words in said
    assert str(wrong) in said
    assert "Traceback" not in said


def test_a_log_without_wheels_of_a_side_is_refused(drive, tmp_path, capsys):
    table, _ = make(Recipe(seed=5, duration_s=20.0))
    table.columns = {
        n: v for n, v in table.columns.items() if "wheel.f" not in n and "rr" not in n
    }
    table.write_csv(tmp_path / "run.csv")
    assert (
        main(["observe", str(tmp_path / "run.csv"), "-o", str(tmp_path / "out.csv")])
        == 2
    )
    assert "the observer needs both sides" in capsys.readouterr().err


def test_mecanum_wheels_need_all_four_speeds(found, tmp_path, capsys):
    config, log, out = (
        tmp_path / name for name in ("config.yaml", "run.csv", "out.csv")
    )
    config.write_text("plant: {drive: mecanum}")
    table, truth = make(
        Recipe(seed=5, duration_s=30.0, drive="mecanum", manoeuvre="omni")
    )
    table.write_csv(log)
    words = [
        "observe",
        str(log),
        "-c",
        str(config),
        "--findings",
        str(found),
        "-o",
        str(out),
    ]
    assert main(words) == 0
    e, sd = errors(out, truth.dense)
    assert np.hypot(*e[:2]).mean() < 0.05
    assert np.mean((e / sd) ** 2) < 4.0
    del table.columns["wheel.rr.speed_rpm"]
    table.write_csv(log)
    assert main(words) == 2
    assert (
        "mecanum wheels move the robot sideways: map all columns"
        in capsys.readouterr().err
    )


def test_the_log_itself_is_not_overwritten(drive, capsys):
    assert main(["observe", str(drive[0]), "-o", str(drive[0])]) == 2
    assert "is the log itself" in capsys.readouterr().err

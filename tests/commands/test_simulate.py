"""`hilserver simulate`: a scenario in virtual time, from tick 0 on, every frame in the file."""

import os
import re
import signal
from pathlib import Path

import numpy as np
import pytest

from hilserver.commands import main
from hilserver.logs import read_log
from hilserver.replay.engine import Engine
from hilserver.replay.simulation import Simulation

SCENARIO = """
steps:
  - {at_s: 0.1, write: {wheels.setpoints_rpm: [30, 30, -30, -30]}}
  - {at_s: 0.6037, write: {control.mode: 1, twist.linear_m_s: 0.2}}
faults:
  - {fault: bias, signal: imu.gyro_z_rad_s, offset: 0.5, from_s: 0.2, until_s: 0.4}
"""


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "drive.yaml").write_text(SCENARIO)


def test_every_frame_from_tick_0_on_and_a_replay_gives_the_same_bits(capsys):
    assert main(["simulate", "drive.yaml", "-o", "drive.mcap"]) == 0
    assert "simulated 1604 ticks (1.604 s) into drive.mcap" in capsys.readouterr().out
    log = read_log(Path("drive.mcap"))
    assert log.ticks(1_000_000).tolist() == list(range(1604))
    assert not log.notices
    setpoint, mode = log.columns["wheel.fl.setpoint_rpm"], log.columns["control.mode"]
    assert np.flatnonzero(np.diff(setpoint))[0] + 1 == 100
    assert np.flatnonzero(np.diff(mode))[0] + 1 == 604
    assert log.columns["imu.gyro_z_rad_s"][300] == pytest.approx(0.5, abs=0.1)


def test_a_replay_of_it_gives_the_same_bits():
    Path("calm.yaml").write_text(SCENARIO.partition("faults:")[0])
    assert main(["simulate", "calm.yaml", "-o", "calm.mcap"]) == 0
    assert main(["replay", "calm.mcap", "-o", "again.csv", "--check"]) == 0


def test_a_duration_and_a_csv_file():
    assert (
        main(["simulate", "drive.yaml", "--duration", "0.25", "-o", "drive.csv"]) == 0
    )
    assert len(read_log(Path("drive.csv"))) == 250


def test_a_log_of_set_points_is_played_too(capsys):
    header = ",".join(
        ["t_s", *(f"wheel.{w}.setpoint_rpm" for w in ("fl", "rl", "fr", "rr"))]
    )
    Path("log.csv").write_text(f"{header}\n0,9,9,-9,-9\n0.5,0,0,0,0\n")
    assert main(["simulate", "log.csv", "-o", "out.csv"]) == 0
    assert "replayed 501 ticks" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("command", "batches"), [("simulate", Simulation.frames), ("replay", Engine.play)]
)
def test_a_signal_ends_the_file_where_a_sentence_says(
    monkeypatch, capsys, command, batches
):
    async def interrupted(*what):
        async for batch in batches(*what):
            yield batch
            os.kill(os.getpid(), signal.SIGTERM)

    owner = Simulation if command == "simulate" else Engine
    monkeypatch.setattr(owner, batches.__name__, interrupted)
    Path("log.csv").write_text("t_s,twist.linear_m_s\n0,0.1\n20,0\n")
    drive = "log.csv" if command == "replay" else "drive.yaml"
    words = ["--duration", "20"] if command == "simulate" else []
    assert main([command, drive, *words, "-o", "out.mcap"]) == 0
    said = capsys.readouterr().err.splitlines()[-1]
    done, n = re.fullmatch(
        r"hilserver: stopped after (\d+) of (\d+) ticks: out\.mcap ends there", said
    ).groups()
    assert 0 < len(read_log(Path("out.mcap"))) == int(done) < int(n)


def test_what_cannot_be_played_is_one_sentence(capsys):
    Path("wrong.yaml").write_text("steps: [{at_s: 0, write: {wheel.fl.speed_rpm: 1}}]")
    assert main(["simulate", "wrong.yaml", "-o", "out.csv"]) == 78
    assert "wrong.yaml:1: " in capsys.readouterr().err


REQUIREMENTS = """
require:
  - {name: turns, signal: pose.yaw_rad, above: 0.1, within_s: 1}
  - {name: gyro, signal: imu.gyro_z_rad_s, below: 1.0}
"""


def test_requirements_decide_the_exit_code(capsys):
    Path("r.yaml").write_text(REQUIREMENTS)
    assert (
        main(["simulate", "drive.yaml", "-o", "drive.mcap", "--require", "r.yaml"]) == 1
    )
    lines = capsys.readouterr().out.splitlines()
    columns = read_log(Path("drive.mcap")).columns
    turns = columns["pose.yaw_rad"][:1001].max() - 0.1
    gyro = 1.0 - columns["imu.gyro_z_rad_s"].max()
    wanted = {name: f"{m:.6g}" for name, m in (("turns", turns), ("gyro", gyro))}
    found = {line[22:]: line[:22].split() for line in lines if line[22:] in wanted}
    for name, text in wanted.items():
        assert found[name] == (
            ["met", text] if float(text) >= 0 else ["NOT", "MET", text]
        )
    Path("r.yaml").write_text(
        REQUIREMENTS.replace("0.1,", "-9,").replace("1.0}", "99}")
    )
    assert (
        main(["simulate", "drive.yaml", "-o", "drive.mcap", "--require", "r.yaml"]) == 0
    )


def test_a_requirement_on_what_does_not_exist_is_refused_before_the_drive(capsys):
    Path("r.yaml").write_text("require: [{name: a, signal: pose.x, below: 1}]")
    assert (
        main(["simulate", "drive.yaml", "-o", "drive.mcap", "--require", "r.yaml"])
        == 78
    )
    assert (
        "r.yaml:1: require[0].signal: there is no scalar signal"
        in capsys.readouterr().err
    )
    assert not Path("drive.mcap").exists()

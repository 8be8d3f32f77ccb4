"""`hilserver sweep` as a user types it."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hilserver.commands import main

COURSE = "steps: [{at_s: 0.0, write: {control.mode: 1, twist.linear_m_s: 0.3}}]"
SWEEP = {
    "machines": 20,
    "seed": 3,
    "from": {
        "population": {
            "wheel_radius": {"uniform": [-0.2, 0.2]},
            "controller.k_i": {"sd": 5},
        }
    },
    "drive": {"scenario": "course.yaml", "duration_s": 1.0},
    "require": [
        {"name": "arrives", "signal": "pose.x_m", "above": 0.24, "within_s": 0.9}
    ],
}


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("course.yaml").write_text(COURSE)
    Path("sweep.yaml").write_text(json.dumps(SWEEP))


def test_a_sweep_from_the_plan_to_the_worst_machine(capsys):
    assert main(["sweep", "sweep.yaml", "--dry-run", "--workers", "2"]) == 0
    said = capsys.readouterr().out
    assert "terms.wheel_radius: uniform -0.2 .. 0.2" in said
    assert "machine 0 took" in said
    command = ["sweep", "sweep.yaml", "-o", "out", "--workers", "2", "--junit", "j.xml"]
    assert main(command) == 0
    said = capsys.readouterr().out
    passed = int(re.search(r"(\d+) of 20 machines pass", said)[1])
    assert 0 < passed < 20
    assert "The report is out/report.html" in said
    report = Path("out/report.html").read_text()
    assert "<code>terms.wheel_radius</code>" in report
    assert Path("j.xml").exists()
    worst = re.search(r'data-head="machine" class="n">(\d+)<', report)[1]
    assert main(["sweep", "sweep.yaml", "-o", "out", "--only", worst]) == 0
    assert "NOT MET" in capsys.readouterr().out
    folder = Path("out") / f"machine-{worst}"
    play = [
        "simulate",
        str(folder / "scenario.yaml"),
        "-c",
        str(folder / "config.yaml"),
    ]
    assert (
        main([*play, "--duration", "1", "-o", "a.mcap", "--require", "sweep.yaml"]) == 1
    )
    margin = json.loads((folder / "margins.json").read_text())["margins"]["arrives"]
    assert f"{margin:.6g}  arrives" in capsys.readouterr().out
    assert main(["sweep", "--compare", "out", "out"]) == 0
    assert f"pass in both {passed}, only in A 0" in capsys.readouterr().out
    assert main([*command[:4], "--resume"]) == 0  # nothing is left to do
    assert main(command) == 1
    assert "continue with --resume" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["--dry-run"], 2, "name a sweep"),
        (["sweep.yaml"], 2, "name a folder for the results with -o"),
        (["sweep.yaml", "-o", "course.yaml"], 1, "is a file"),
        (["none.yaml", "-o", "out"], 78, "no such file"),
        (["sweep.yaml", "-o", "out", "--only", "20"], 2, "machines are 0 .. 19"),
        (["--compare", "out", "out"], 2, "contains no finished sweep"),
    ],
)
def test_what_cannot_be_is_one_sentence(capsys, arguments, code, says):
    assert main(["sweep", *arguments]) == code
    said = capsys.readouterr().err
    assert says in said
    assert "Traceback" not in said
    assert not Path("out/report.html").exists()


@pytest.mark.parametrize(
    ("moment", "says"),
    [
        ("prepare", "stopped before any machine had finished"),
        ("rig_for", "stopped before any machine had finished"),
        ("LocalWorkers", "stopped after 0 of 20 machines; go on with --resume"),
        ("write_report", "stopped after 0 of 20 machines; go on with --resume"),
    ],
)
def test_a_signal_at_any_moment_is_one_sentence(monkeypatch, capsys, moment, says):
    monkeypatch.setattr("hilserver.commands.sweep.outcomes", lambda *_, **__: ())
    interrupted = lambda *_: os.kill(os.getpid(), signal.SIGTERM)  # noqa: E731
    monkeypatch.setattr(f"hilserver.commands.sweep.{moment}", interrupted)
    assert main(["sweep", "sweep.yaml", "-o", "out", "--workers", "1"]) == 0
    assert capsys.readouterr().err.splitlines()[-1] == f"hilserver: {says}"
    assert not Path("out/report.html").exists()


@pytest.mark.long
def test_control_c_keeps_what_is_finished_and_resume_gives_the_same_bits():
    sweep = SWEEP | {
        "machines": 600,
        "drive": {"scenario": "course.yaml", "duration_s": 4.0},
    }
    Path("sweep.yaml").write_text(json.dumps(sweep))
    command = [
        sys.executable,
        "-m",
        "hilserver",
        "sweep",
        "sweep.yaml",
        "--workers",
        "2",
        "-o",
    ]
    first = subprocess.Popen([*command, "out"])
    journal = Path("out/finished.jsonl")
    while not journal.exists() or len(journal.read_bytes().splitlines()) < 40:
        assert first.poll() is None
        time.sleep(0.05)
    first.send_signal(signal.SIGINT)
    assert first.wait(600) == 0
    finished = len(journal.read_bytes().splitlines()) - 1
    assert finished < 600
    subprocess.run([*command, "out", "--resume"], check=True)
    subprocess.run([*command, "whole"], check=True)
    for name in ("results.parquet", "summary.json", "report.html"):
        assert Path("out", name).read_bytes() == Path("whole", name).read_bytes()

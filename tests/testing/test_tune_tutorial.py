"""Every command of the tutorial about tuning and the FMU, in its order, in a copy of its folder."""

import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.daemons import free_port

DOCS = Path(__file__).parents[2] / "docs" / "tutorial"
TEXT = (DOCS / "tune-and-export.md").read_text(encoding="utf-8")
ALONE = """
opcua: {{endpoint: "opc.tcp://127.0.0.1:{port}/hilserver"}}
image: {{name: auto}}
metrics: {{enabled: false}}
page: {{enabled: false}}
scheduler:
  communication_timeout_ms: 0
  limits: {{single_overrun_ms: null, consecutive_overruns: null}}
"""
"""Beside other tests, and on a busy computer."""


@pytest.fixture
def folder(tmp_path):
    shutil.copytree(DOCS / "tune-and-export", tmp_path, dirs_exist_ok=True)
    with (tmp_path / "robot.yaml").open("a", encoding="utf-8") as file:
        file.write(ALONE.format(port=free_port()))
    return tmp_path


def commands():
    """The lines that a user types after the preparation."""
    blocks = re.findall(r"```console\n(.*?)```", TEXT, re.DOTALL)
    lines = [line[2:] for block in blocks for line in block.splitlines()]
    return [line for line in lines if not line.startswith(("cd ", "export "))]


def argv(line):
    program, *words = line.split()
    own = {"hilserver": [sys.executable, "-m", "hilserver"], "python": [sys.executable]}
    return [*own[program], *words]


def done(line, folder):
    ended = subprocess.run(
        argv(line), cwd=folder, capture_output=True, text=True, timeout=600, check=False
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


def test_every_command_does_what_the_page_says(folder):
    start, *rest = commands()
    log = folder / "run.log"
    with log.open("wb") as file:
        daemon = subprocess.Popen(argv(start), cwd=folder, stdout=file, stderr=file)
    try:
        while b"hilserver is running" not in log.read_bytes():
            with pytest.raises(subprocess.TimeoutExpired):
                daemon.wait(0.2)
        while_it_runs = rest[:2]
        assert [line.split()[1] for line in while_it_runs] == ["set", "call"]
        for line in while_it_runs:
            done(line, folder)
    finally:
        daemon.send_signal(signal.SIGINT)
        daemon.wait(600)
    assert "value: 2.0" in (folder / "patches" / "tuned.yaml").read_text()
    said = [done(line, folder) for line in rest[2:]]
    assert len(said) == 4
    assert "No problems found" in said[2]
    shown = re.search(r"```\n(pose\.x_m.*?)```", TEXT, re.DOTALL)
    assert said[3] == shown[1]
    assert said[3].count("largest difference 0\n") == 5

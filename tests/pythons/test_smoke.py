"""The installed program on this interpreter: it starts, drives over OPC UA, simulates, diagnoses.

`make test-pythons` runs this on every Python with the newest and the lowest versions that we allow.
"""

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

CONFIG = f"""
image: {{name: smoke-{os.getpid()}}}
opcua: {{endpoint: "opc.tcp://127.0.0.1:0/hilserver"}}
metrics: {{port: 0}}
page: {{port: 0}}
"""
SCENARIO = """
steps:
  - {at_s: 0.5, write: {wheels.setpoints_rpm: [30, 30, -30, -30]}}
  - {at_s: 3.0, write: {wheels.setpoints_rpm: [20, 20, 20, 20]}}
  - {at_s: 6.0, write: {wheels.setpoints_rpm: [40, 40, -30, -30]}}
"""


@pytest.fixture(scope="module")
def hilserver(tmp_path_factory):
    """Run a command of the program in a folder of its own; a deprecation is an error."""
    folder = tmp_path_factory.mktemp("smoke")
    (folder / "config.yaml").write_text(CONFIG)
    (folder / "drive.yaml").write_text(SCENARIO)

    def run(*words: str) -> str:
        done = subprocess.run(
            [sys.executable, "-m", "hilserver", *words],
            cwd=folder,
            env=os.environ | {"PYTHONWARNINGS": "error::DeprecationWarning"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=600,
            check=False,
        )
        assert done.returncode == 0, done.stdout
        assert "Traceback" not in done.stdout
        assert "DeprecationWarning" not in done.stdout
        return done.stdout

    run.folder = folder
    return run


def test_it_starts(hilserver):
    assert hilserver("--version").startswith("hilserver ")
    assert "OPC UA: opc.tcp://" in hilserver("check")


def test_the_embedded_controller_drives_it_over_opc_ua(hilserver):
    hilserver("run", "--demo", "--duration", "20", "--record", "demo.csv")
    with (hilserver.folder / "demo.csv").open(newline="") as file:
        speeds = [float(row["wheel.fl.speed_rpm"]) for row in csv.DictReader(file)]
    assert max(map(abs, speeds)) > 5


def test_what_it_simulates_can_be_diagnosed(hilserver):
    hilserver("simulate", "drive.yaml", "--duration", "9", "-o", "drive.mcap")
    hilserver("diagnose", "drive.mcap", "-o", "report")
    report = Path(hilserver.folder / "report")
    assert json.loads((report / "findings.json").read_text())["verdict"]
    assert (report / "report.html").stat().st_size > 1000

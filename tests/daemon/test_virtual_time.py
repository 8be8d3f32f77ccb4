"""The daemon in virtual time: a duration is simulated time, a recording loses nothing."""

import os
import subprocess
import sys

import numpy as np
import pytest

from hilserver.logs import read_log

CONFIG = """
scheduler: {backend: virtual}
image: {name: auto, ring_frames: 16}
opcua: {enabled: false}
metrics: {enabled: false}
recording: {buffer_mb: 1}
"""
SCENARIO = "steps: [{at_s: 0, write: {wheels.setpoints_rpm: [30, 30, -30, -30]}}]\n"


@pytest.mark.parametrize(
    "name", ["run.mcap", pytest.param("run.csv", marks=pytest.mark.long)]
)
def test_a_recording_begins_at_tick_0_and_holds_every_tick_of_the_duration(
    tmp_path, name
):
    (tmp_path / "config.yaml").write_text(CONFIG)
    (tmp_path / "drive.yaml").write_text(SCENARIO)
    words = [
        "run",
        "--duration",
        "12.345",
        "--record",
        name,
        "--scenario",
        "drive.yaml",
    ]
    done = subprocess.run(
        [sys.executable, "-m", "hilserver", *words],
        cwd=tmp_path,
        env=os.environ | {"NO_COLOR": "1"},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "recorded 12345 frames" in done.stderr
    assert "none lost" in done.stderr
    log = read_log(tmp_path / name)
    assert np.array_equal(log.ticks(1_000_000), np.arange(12_345))
    assert log.states[0].tick == 0
    assert not log.notices
    assert log.columns["wheel.fl.speed_rpm"][-1] == pytest.approx(30.0)

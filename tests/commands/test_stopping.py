"""A signal ends every command with exit code 0, one sentence, and no half of a file."""

import importlib
import os
import signal
import tempfile

import numpy as np
import pytest

from hilserver.commands import main
from tests.fakes import image_name

SENTENCE = "hilserver: stopped before it was finished"
WHEELS = [f"wheel.{wheel}.speed_rpm" for wheel in ("fl", "rl", "fr", "rr")]
CONFIG = """opcua: {enabled: false}
page: {enabled: false}
metrics: {enabled: false}
peers: [{name: absent, endpoint: 'opc.tcp://127.0.0.1:9/x', read: {'ns=1;s=a': drive.enable}}]
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Give a folder with a log and a configuration; temporary files are made in it, too."""
    t_s = np.arange(100) * 0.02
    rows = [",".join(["t_s", *WHEELS, "imu.gyro_z_rad_s"])]
    rows += [f"{t:.2f},10,10,-10,-10,0" for t in t_s]
    (tmp_path / "log.csv").write_text("\n".join(rows) + "\n")
    (tmp_path / "where.csv").write_text("before\n")
    (tmp_path / "config.yaml").write_text(f"{CONFIG}image: {{name: {image_name()}}}\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def interrupted_after(monkeypatch, place, number):
    """Let a signal come when the function at `place` has done its work."""
    module, _, name = place.rpartition(".")
    module = importlib.import_module(module)
    work = getattr(module, name)

    def done(*arguments, **options):
        result = work(*arguments, **options)
        os.kill(os.getpid(), number)
        return result

    monkeypatch.setattr(module, name, done)


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("hilserver.commands.convert._write", "convert log.csv out.csv"),
        ("hilserver.commands.convert._write", "convert log.csv out.mcap"),
        ("hilserver.commands.convert._write", "convert log.csv out.mf4"),
        ("hilserver.commands.convert._write", "convert log.csv out.parquet"),
        ("hilserver.commands.convert._write", "convert log.csv out"),
        ("hilserver.commands.identify.read_measured", "identify noise log.csv"),
        ("hilserver.commands.observe.write_log", "observe log.csv -o where.csv"),
        ("hilserver.commands.observe.write_log", "observe log.csv -o out.mcap"),
        ("hilserver.bench.plant.build", "bench plant --json out.json"),
        ("hilserver.fmu.export._header", "fmu -o out.fmu"),
        # 17 s of translating to C; the header is interrupted in the same command.
        pytest.param(
            "hilserver.fmu.export._sources", "fmu -o out.fmu", marks=pytest.mark.long
        ),
        ("hilserver.commands.wiring._say", "wiring --timeout 5"),
    ],
)
def test_a_signal_is_one_sentence_and_leaves_no_half_of_a_file(
    folder, monkeypatch, capsys, place, words
):
    number = signal.SIGINT if "csv" in words else signal.SIGTERM
    before = {path: path.read_bytes() for path in folder.iterdir()}
    interrupted_after(monkeypatch, place, number)
    assert main(words.split()) == 0
    assert capsys.readouterr().err.splitlines()[-1] == SENTENCE
    assert {path: path.read_bytes() for path in folder.iterdir()} == before

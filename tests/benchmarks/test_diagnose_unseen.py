"""Public machines: read from a clone; the patch of one drive beside least squares on the other."""

import subprocess

import numpy as np
import pytest
from scipy.io import savemat

from benchmarks import diagnose, diagnose_unseen
from benchmarks.diagnose_unseen import Pair, plain_least_squares, there, work
from benchmarks.public_machines import PUBLIC_MACHINES, commit, write_columns
from hilserver.errors import FailedError
from hilserver.measured.reading import read_measured
from tests.benchmarks.test_diagnose import arguments

PIONEER = PUBLIC_MACHINES[0]
ROW_S = 0.1
TURNS_LESS, SKEW_RAD, LATE_ROWS = -0.06, 0.1, 2


def drive(folder, duration_s=240.0):
    """Write a drive as the repository holds it; it turns less, the reference is askew and late."""
    rng = np.random.default_rng(7)
    t_s = ROW_S * np.arange(round(duration_s / ROW_S))
    # a new speed and turn every four seconds, approached within one
    held = np.repeat(
        rng.uniform([0.0, -0.6], [0.4, 0.6], (len(t_s) // 40 + 1, 2)), 40, axis=0
    )
    smooth = np.ones(10) / 10.0
    v, om = (np.convolve(held[: len(t_s), k], smooth)[: len(t_s)] for k in range(2))
    turn = (1.0 + TURNS_LESS) * om
    yaw = np.append(0.0, np.cumsum(0.5 * (turn[1:] + turn[:-1]) * ROW_S))
    way = np.exp(1j * yaw) * v
    place = np.append(0.0, np.cumsum(0.5 * (way[1:] + way[:-1]) * ROW_S))

    late = np.maximum(np.arange(len(t_s)) - LATE_ROWS, 0)
    shown = place[late] + rng.normal(0.0, 2e-3, (2, len(t_s))).T @ [1.0, 1j]
    heading = yaw[late] + SKEW_RAD + rng.normal(0.0, 2e-3, len(t_s))
    folder.mkdir()
    savemat(
        folder / "dataset2.mat",
        {
            "t": t_s, "v": v, "om": om, "true_valid": np.ones(len(t_s)),
            "x_true": shown.real, "y_true": shown.imag, "th_true": heading,
        },
    )  # fmt: skip


@pytest.fixture(scope="module")
def clones(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clones")
    drive(folder / "aer1513")
    return folder


def test_what_is_there(clones):
    assert there(clones) == [PIONEER]
    first, second = PIONEER.read(clones)
    assert len(first["t_s"]) == len(second["t_s"]) == 1200
    assert first["t_s"][-1] < second["t_s"][0]


def test_least_squares_find_turn_axis_and_delay(clones, tmp_path):
    (tmp_path / "mapping.yaml").write_text(PIONEER.mapping(), encoding="utf-8")
    write_columns(tmp_path / "drive.csv", PIONEER.read(clones)[0])
    log = read_measured([tmp_path / "drive.csv"], str(tmp_path / "mapping.yaml"))
    found = plain_least_squares(diagnose_unseen._problem(log))
    assert found["rotation_gain"] == pytest.approx(TURNS_LESS, abs=0.01)
    assert found["nav_frame_yaw"] == pytest.approx(SKEW_RAD, abs=0.01)
    assert found["shift.nav"] == pytest.approx(LATE_ROWS * ROW_S, abs=0.03)
    assert found["wheel_radius"] == pytest.approx(0.0, abs=0.01)


@pytest.mark.long
def test_the_patch_predicts_the_other_drive_as_well(clones):
    record = work(Pair(clones, PIONEER, 0, 1))
    means = record["means"]
    for name, configured in means["configured"].items():
        assert means["patch"][name] < 0.3 * configured
        assert means["patch"][name] < 1.2 * means["least squares"][name]
    assert record["source"] == "17SingerAbel/aer1513@?"


def test_a_table_of_what_was_measured(clones, tmp_path, monkeypatch, capsys):
    asked = []

    def done(pair):
        asked.append(pair.key)
        means = {
            "configured": {"yaw_rad": 0.4},
            "corrected": {"yaw_rad": 0.3},
            "patch": {"yaw_rad": 0.1},
            "least squares": {"yaw_rad": 0.12},
        }
        return {
            "key": pair.key,
            "machine": pair.machine.name,
            "source": "a/b@c",
            "findings": [["named", "rotation_gain"]],
            "means": means,
            "headline": {"yaw_rad": [2.0, 2.9 + pair.learned]},
        }

    monkeypatch.setattr(diagnose_unseen, "work", done)
    args = arguments(tmp_path, ("--public", str(clones)))
    diagnose.run(args)
    figures = {row.name: row.value for row in diagnose.run(args)}
    assert asked == [f"{PIONEER.name}/0", f"{PIONEER.name}/1"]
    assert figures["heading: geometric mean"] == pytest.approx(1.2)
    assert figures["headlines whose interval holds the gain"] == pytest.approx(0.5)
    assert (
        f"| {PIONEER.name} | a/b@c | 2 | heading | 0.4000 | 0.1200 | 0.1000 | 1.20 | 3.00"
        " | 2.00 to 3.90 |"
    ) in capsys.readouterr().out.splitlines()


def test_a_clone_without_its_data(tmp_path):
    (tmp_path / "aer1513").mkdir()
    with pytest.raises(FailedError, match="clone 17SingerAbel/aer1513 again"):
        PIONEER.read(tmp_path)


def test_the_commit_of_a_clone(tmp_path):
    assert commit(tmp_path) == "?"
    for words in (("init", "-q"), ("-c", "user.name=a", "-c", "user.email=a", "commit",
                                   "-q", "--allow-empty", "-m", "a")):  # fmt: skip
        subprocess.run(["git", "-C", str(tmp_path), *words], check=True)
    assert len(commit(tmp_path)) == 10


def test_every_mapping_can_be_read(tmp_path):
    """Columns and plant of each machine are those that a mapping may hold."""
    for machine in PUBLIC_MACHINES:
        text = machine.mapping()
        assert "plant:" in text
        names = {
            said if isinstance(said, str) else said["column"]
            for said in machine.channels.values()
        }
        rng = np.random.default_rng(0)
        t_s = 0.1 * np.arange(50)
        columns = {"t_s": t_s} | {name: rng.normal(size=50) for name in sorted(names)}
        write_columns(tmp_path / "drive.csv", columns)
        (tmp_path / "mapping.yaml").write_text(text, encoding="utf-8")
        log = read_measured([tmp_path / "drive.csv"], str(tmp_path / "mapping.yaml"))
        assert log.channels

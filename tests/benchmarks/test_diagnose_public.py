"""Public calibration runs: each method finds the robot that made them; the table beside a patch."""

import json

import numpy as np
import pytest

from benchmarks import diagnose, diagnose_public
from benchmarks.calibration_methods import METHODS, missed, odometry, of_dimensions
from benchmarks.calibration_runs import (
    DIFFERENTIAL,
    MACHINES,
    ROLLERS,
    Run,
    read_runs,
    sets_of_squares,
    write_table,
)
from benchmarks.diagnose_public import MAPPINGS, PATCH, Task, ends_of, work
from hilserver.errors import FailedError
from hilserver.measured.reading import read_measured
from tests.benchmarks.test_diagnose import arguments

TICKS = 43.7 * 64
ROW_S = 0.05
TRUE = {
    DIFFERENTIAL: np.array([0.2016, 0.08405, 0.08395]),
    ROLLERS: np.array([0.412, 0.0606, 0.0603, 0.0605, 0.0608]),
}
"""Width and diameters of the robots that made the runs [m]."""


def square(machine, clockwise, seed=0, side_m=1.0):
    """Turns of each wheel in every row: a square by the configured robot, from rest to rest."""
    nominal = np.linalg.pinv(
        of_dimensions(
            machine,
            np.array(
                [machine.width_m] + len(machine.columns) * [machine.wheel_diameter_m]
            ),
        )
    )
    rng = np.random.default_rng(seed)
    speed = rng.uniform(0.2, 0.3)
    ahead, turn = round(side_m / speed / ROW_S), round(0.5 * np.pi / 0.8 / ROW_S)
    sideways = 0.1 * speed if machine is ROLLERS else 0.0
    side = np.tile([side_m / ahead, sideways * ROW_S, 0.0], (ahead, 1))
    way = -1.0 if clockwise else 1.0
    corner = np.tile([0.0, 0.0, way * 0.5 * np.pi / turn], (turn, 1))
    moved = np.concatenate([np.zeros((10, 3)), *4 * [side, corner], np.zeros((10, 3))])
    return moved @ nominal.T


def made(machine, folder, name, count=4, seed=0):
    """Write a set of runs as the authors did: clockwise ones first, whole ticks."""
    place = folder / "data" / machine.name / "square" / name
    place.mkdir(parents=True)
    matrix = of_dimensions(machine, TRUE[machine])
    rows = {"type": machine.name, "ngear": 43.7, "encRes": 64, "N": count, "L": 1.0}
    text = "".join(f"{key},{value},,\n" for key, value in rows.items())
    (place / f"{name}_metadata.csv").write_text(text, encoding="utf-8")
    rng = np.random.default_rng(seed)
    for number in range(1, count + 1):
        turned = square(machine, number <= count // 2, seed + number)
        total = np.rint(np.cumsum(turned, axis=0) * TICKS / (2.0 * np.pi))
        ticks = np.diff(total, axis=0, prepend=0.0)
        t_s = ROW_S * np.arange(len(ticks))
        start = np.zeros((len(t_s), 3))
        run = Run("", 1.0, True, t_s, start, ticks * (2.0 * np.pi / TICKS))
        seen = odometry(matrix, run) + rng.normal(0.0, 2e-4, start.shape)
        table = np.column_stack([t_s, seen, ticks])
        np.savetxt(place / f"{name}_run-{number:02d}.csv", table, delimiter=",")


@pytest.fixture(scope="module")
def clone(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clones") / "odometry-calibration"
    for machine in MACHINES:
        made(machine, folder, "a", 8)
        made(machine, folder, "b", 8, seed=100)
    return folder


@pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.name)
def test_every_method_makes_the_end_right(clone, machine):
    runs = read_runs(clone, machine)
    assert [run.clockwise for run in runs] == 2 * (4 * [True] + 4 * [False])
    assert sets_of_squares(runs) == ["square/a", "square/b"]
    ends = {}
    for name, method in METHODS[machine.name].items():
        matrix = method(machine, runs)
        off = np.abs([missed(matrix, run) for run in runs])
        ends[name] = off.max(axis=0)
    as_configured = ends.pop("as configured")
    for end in ends.values():
        assert (end < 0.35 * as_configured).all()


def test_the_widths_are_those_of_the_robot(clone):
    """Neither of the two closed forms tells the size of the wheels, only what follows from it."""
    runs = read_runs(clone, DIFFERENTIAL)
    true = of_dimensions(DIFFERENTIAL, TRUE[DIFFERENTIAL])
    for name in ("UMBmark", "Jung and Chung", "OptiOdom"):
        matrix = METHODS["diff"][name](DIFFERENTIAL, runs)
        assert matrix[2] == pytest.approx(true[2], rel=1e-3), name


@pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.name)
def test_the_plant_without_a_patch_is_the_configured_odometry(clone, machine, tmp_path):
    """The replay begins at the measured pose, too, so both are off by the same at the end."""
    runs = read_runs(clone, machine)[:8]
    write_table(tmp_path / "runs.csv", runs, machine)
    mapping = str(MAPPINGS / f"{machine.mapping}.yaml")
    away_m, turned_rad = ends_of(read_measured([tmp_path / "runs.csv"], mapping), {})
    matrix = METHODS[machine.name]["as configured"](machine, runs)
    off = np.stack([missed(matrix, run) for run in runs])
    assert away_m == pytest.approx(np.hypot(off[:, 0], off[:, 1]), abs=2e-3)
    assert turned_rad == pytest.approx(np.abs(off[:, 2]), abs=2e-3)


def test_the_patch_makes_the_end_of_left_out_runs_right(clone):
    record = work(Task(clone, DIFFERENTIAL, "square/a", 1))
    ends = {name: np.mean(values, axis=1) for name, values in record["ends"].items()}
    assert (ends[PATCH] < 0.35 * ends["as configured"]).all()
    assert record["patch"]


def test_a_table_from_what_was_measured(clone, tmp_path, monkeypatch, capsys):
    """Sets that a file of results holds are not diagnosed again."""
    args = arguments(tmp_path, ("--public", str(clone.parent)))
    asked = []

    def done(task):
        asked.append(task.key)
        ends = {name: [[0.02, 0.01], [0.2, 0.1]] for name in METHODS[task.machine.name]}
        ends[PATCH] = [[0.01, 0.005], [0.1, 0.05]]
        return {"key": task.key, "ends": ends, "patch": {"rotation_gain": -0.01}}

    monkeypatch.setattr(diagnose_public, "work", done)
    figures = {row.name: row for row in diagnose.run(args)}
    diagnose.run(args)
    assert asked == [f"{m.name}/square/{x}" for m in MACHINES for x in "ab"]
    assert figures["diff: mean distance at the end"].ratio == pytest.approx(2.0)
    lines = capsys.readouterr().out.splitlines()
    assert (
        "| OptiOdom | 0.0150 | 0.0150 | 0.0200 | 8.59 | 11.46 | 0.0539 | 3.34 |"
        in lines
    )
    assert "diff/square/a: rotation_gain -0.01" in lines
    assert all(json.loads(line) for line in args.resume.read_text().splitlines())


def test_what_is_no_clone(tmp_path):
    with pytest.raises(
        FailedError, match="clone one of sousarbarb/odometry-calibration, "
    ):
        diagnose.run(arguments(tmp_path, ("--public", str(tmp_path))))


@pytest.mark.parametrize(
    "spoil",
    [
        lambda place: (place / "a_metadata.csv").write_text("N,4\n", encoding="utf-8"),
        lambda place: (place / "a_run-02.csv").unlink(),
        lambda place: (place / "a_run-01.csv").write_text("oops\n", encoding="utf-8"),
    ],
    ids=["metadata", "missing", "text"],
)
def test_a_damaged_clone_is_one_sentence(tmp_path, spoil):
    made(DIFFERENTIAL, tmp_path, "a", 4)
    spoil(tmp_path / "data" / "diff" / "square" / "a")
    with pytest.raises(FailedError, match=r"a_metadata\.csv: cannot be read"):
        read_runs(tmp_path, DIFFERENTIAL)

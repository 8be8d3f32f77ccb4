"""The robot as an FMU beside a recording of 1,000 s: all terms on, two importers, the same bits."""

import random
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from fmpy import read_model_description

from hilserver.commands import main
from hilserver.logs import read_log
from hilserver.plant.layout import WHEELS
from hilserver.plant.reference.cases import cases
from hilserver.plant.terms import TERMS
from tests.fmu import importing

N, STEP_S, STEPS = 1_000_000, 0.001, 1500
CONFIG = {
    "control": {"source": "scenario"},
    "plant": {"seed": 11},
    "sensors": {
        "nav": {"enabled": True, "white_noise_m": 0.003, "correlated_noise_m": 0.01},
        "imu": {"gyro_noise_rad_s": 0.002, "accel_noise_m_s2": 0.01},
    },
}
ALL = {
    name: {"value": v, "unit": TERMS[name].unit}
    for name, v in cases()["everything"].items()
}
PATCH = {
    "schema": "hilserver.model_patch/1",
    "made_from": {"findings_sha256": "", "config_sha256": "", "version": "1"},
    "terms": ALL,
}
pytestmark = pytest.mark.long


def drive():
    """Steps of a scenario: set-points of wheels, twists, duties, and the brake between."""
    rng = random.Random(9)
    for at_s in np.linspace(0.0, N * STEP_S, STEPS, endpoint=False).tolist():
        mode = rng.choice([0, 0, 1, 1, 2])
        write = {"control.mode": mode, "drive.enable": rng.random() < 0.95}
        if mode == 1:
            write |= {"twist.linear_m_s": rng.uniform(-0.5, 0.5)}
            write |= {"twist.angular_rad_s": rng.uniform(-2.0, 2.0)}
        else:
            name = "setpoint_rpm" if mode == 0 else "duty_command_pct"
            write |= {f"wheel.{w}.{name}": rng.uniform(-60.0, 60.0) for w in WHEELS}
        yield {"at_s": round(at_s, 3), "write": write}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("million")
    files = {"config": CONFIG, "patch": PATCH, "drive": {"steps": list(drive())}}
    for name, content in files.items():
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    robot = ["-c", str(folder / "config.yaml"), "--patch", str(folder / "patch.yaml")]
    out = ["-o", str(folder / "drive.mcap"), "--duration", str(N * STEP_S)]
    assert main(["simulate", str(folder / "drive.yaml"), *robot, *out]) == 0
    assert main(["fmu", *robot, "-o", str(folder / "robot.fmu")]) == 0
    return folder


@pytest.fixture(scope="module")
def recorded(folder):
    """The inputs as rows of step, reference and value, and the outputs of every tick."""
    log = read_log(folder / "drive.mcap")
    said = read_model_description(str(folder / "robot.fmu")).modelVariables
    rows = []
    for v in said:
        if v.causality == "input":
            column = log.columns[v.name]
            changed = np.flatnonzero(np.diff(column, prepend=np.nan))
            rows += [(k, v.valueReference, column[k]) for k in changed.tolist()]
    assert len(rows) > 5_000
    np.array(sorted(rows)).tofile(folder / "rows")
    outputs = [log.columns[v.name] for v in said if v.causality == "output"]
    return np.array(outputs).T


def test_an_importer_in_c_on_libm_and_libc_alone(folder, recorded):
    rows = np.fromfile(folder / "rows").reshape(-1, 3)
    fmu, program = folder / "robot.fmu", importing.compiled(folder)
    library = importing.unpacked(folder, fmu)
    assert importing.linked_to(program) == {"libc"}
    assert importing.linked_to(library) == {"libm", "libc"}
    found = importing.run(program, library, fmu, rows, N)
    assert np.array_equal(found, recorded, equal_nan=True)


def test_fmpy_with_a_state_restored_half_way_and_a_thousand_robots(folder, recorded):
    program = Path(__file__).with_name("million.py")
    words = [folder / "robot.fmu", folder / "rows", N, folder / "outputs"]
    done = subprocess.run(
        [sys.executable, program, *map(str, words)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    print(done.stdout)
    found = np.fromfile(folder / "outputs").reshape(recorded.shape)
    assert np.array_equal(found, recorded, equal_nan=True)

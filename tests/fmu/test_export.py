"""The robot as an FMU: beside the daemon's own robot it computes the same bits."""

import random
import subprocess
import sys
import zipfile

import numpy as np
import pytest
from fmpy import read_model_description
from fmpy.validation import validate_fmu

from hilserver.commands import main
from hilserver.daemon.builder import build
from hilserver.fmu.description import read_fmu
from hilserver.fmu.variables import N_U, N_Y
from hilserver.image import Row
from hilserver.parameters import PLANT
from tests.fmu import importing
from tests.fmu.rig import configured

ROBOT = {
    "sensors": {
        "nav": {"enabled": True, "white_noise_m": 0.003, "correlated_noise_m": 0.01},
        "imu": {"gyro_noise_rad_s": 0.002},
    },
    "plant": {
        "seed": 11,
        "terms": {
            "rotation_gain": -0.2, "dead_zone": 3.0, "actuation_delay": 0.012, "body_lag": 0.05,
            "encoder_quantization": 0.5, "backlash": 0.01, "wheel_runout.amplitude": 0.01,
            "floor_slope.x": 0.01, "gyro_bias": 0.003, "imu_latency": 0.02, "viscous_load": 0.1,
            "heading_distortion.a1": 0.02, "nav_outliers.share": 0.05, "nav_outliers.size": 0.2,
        },
    },
}  # fmt: skip
N = 4000


def exported(folder, version=3, *words):
    configured(folder, **ROBOT)
    path = folder / f"robot{version}.fmu"
    command = [
        "fmu",
        "-c",
        str(folder / "config.yaml"),
        "-o",
        str(path),
        "--fmi",
        str(version),
    ]
    assert main([*command, *words]) == 0
    return path


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    folder = tmp_path_factory.mktemp("exported")
    return {version: exported(folder, version) for version in (2, 3)}


def drives():
    """Set-points, a twist, the safe ramp, another pose, duties."""
    rng = random.Random(4)
    rows = [
        (
            tick,
            f"wheel.{rng.choice(('fl', 'rl', 'fr', 'rr'))}.setpoint_rpm",
            rng.uniform(-90, 90),
        )
        for tick in sorted(rng.choices(range(N), k=200))
    ]
    rows += [(1000, "control.mode", 1.0), (1000, "twist.angular_rad_s", 0.4)]
    rows += [(1500, "internal.command", 2.0), (2100, "internal.command", 0.0)]
    rows += [(2200, "internal.pose_x_m", 3.0), (2200, "internal.pose_request", 1.0)]
    rows += [(3000, "control.mode", 2.0), (3000, "wheel.fl.duty_command_pct", 40.0)]
    return sorted(rows)


async def both(folder, fmu, writes, start=(), tuned=()):
    """Outputs of the daemon's robot and of the FMU beside it, shape (N, N_Y) each."""
    names = [s.name for s in configured(folder).table.scalars if s.slots[0] < N_U]
    block = {
        "name": "copy",
        "fmu": str(fmu),
        "inputs": {n: n for n in names},
        "start": dict(start),
    }
    async with build(configured(folder, block, **ROBOT)) as core:
        core.image.control.state = -1  # the commands come in rows
        table = core.table
        rows = [Row(table.slot(name), value, tick=tick) for tick, name, value in writes]
        assert core.image.push_timed(rows)
        for due, values in tuned:  # of the robot and of the FMU in one tick
            copied = {
                f"blocks.copy.{name}": value or 0.0 for name, value in values.items()
            }
            core.parameters.apply(core.parameters.checked(values | copied), due=due)
        await core.scheduler.advance(N)
        frames = np.array([core.image.frame(i).values for i in range(N)])
        first = next(s.slots[0] for s in table.scalars if s.name.startswith("copy."))
        return frames[:, N_U : N_U + N_Y], frames[:, first : first + N_Y]


@pytest.mark.parametrize("version", [2, 3])
async def test_it_computes_the_bits_of_the_daemon(fmu, tmp_path, version):
    ours, copy = await both(tmp_path, fmu[version], drives())
    assert np.ptp(ours[:, 12]) > 0.5, "it has moved"
    assert np.array_equal(ours, copy, equal_nan=True)


async def test_another_seed_gives_other_noise_alone(fmu, tmp_path):
    ours, copy = await both(tmp_path, fmu[3], drives(), {"seed": 12}.items())
    differs = {int(i) for i in np.flatnonzero((ours != copy).any(axis=0))}
    assert differs
    assert min(differs) >= 18, "the sensors' outputs"


@pytest.mark.parametrize("version", [2, 3])
async def test_what_is_tuned_while_it_drives_gives_the_bits_of_the_daemon(
    fmu, tmp_path, version
):
    tuned = [
        (700, {"terms.dead_zone": 8.0, "terms.gyro_bias": -0.1}),
        (800, {"terms.body_lag": 0.0, "terms.floor_slope.x": 0.2}),
        (900, {"terms.body_lag": 0.2, "terms.wheel_runout.amplitude": 0.0}),
        (1050, {"plant.exclusive_twist": 1.0, "kinematics.rotation_gain": 1.052}),
        (1200, {"plant.exclusive_twist": 0.0, "terms.setpoint_rate_limit": 50.0}),
        (1400, {"kinematics.rotation_gain": None, "terms.setpoint_rate_limit": None}),
        (1700, {"terms.encoder_quantization": 0.0, "sensors.nav.white_noise_m": 0.1}),
        (1800, {"plant.controller.k_p": 6.0, "plant.controller.k_i": 60.0}),
        (1900, {"plant.controller.k_d": 0.02, "terms.controller_gains.p": 0.3}),
        (
            2000,
            {
                "plant.process.t1_s": 0.09,
                "terms.time_constant": 0.1,
                "terms.encoder_filter": 0.01,
            },
        ),
        (
            2300,
            {
                "plant.wheel_radius_m": 0.07,
                "plant.track_m": 0.4,
                "plant.icr_offset_m": -0.05,
            },
        ),
        (2500, {"terms.actuation_delay": 0.03, "terms.imu_latency": 0.005}),
        (2700, {"sensors.nav.rate_hz": 50.0, "sensors.nav.latency_s": 0.04}),
        (2900, {"kinematics.yaw_sign": 1.0, "sensors.battery.capacity_ah": 1.0}),
    ]
    writes = sorted([*drives(), (1000, "twist.linear_m_s", 0.1)])
    ours, copy = await both(tmp_path, fmu[version], writes, tuned=tuned)
    assert np.array_equal(ours, copy, equal_nan=True)
    as_made, _ = await both(tmp_path, fmu[version], writes)
    assert [int(np.argmax((ours != as_made).any(axis=1)))] == [700]


@pytest.mark.parametrize("version", [2, 3])
def test_the_checker_has_no_complaint_and_it_needs_libm_and_libc_alone(
    fmu, tmp_path, version
):
    assert validate_fmu(str(fmu[version])) == []
    with zipfile.ZipFile(fmu[version]) as packed:
        (library,) = (n for n in packed.namelist() if n.endswith(".so"))
        packed.extract(library, tmp_path)
    needed = subprocess.run(
        ["readelf", "-d", tmp_path / library],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    names = {
        line.split("[")[1][:-1] for line in needed.splitlines() if "NEEDED" in line
    }
    assert names == {"libm.so.6", "libc.so.6"}


def test_signals_and_parameters_have_their_names_units_and_ranges(fmu):
    said = {v.name: v for v in read_model_description(str(fmu[3])).modelVariables}
    assert said["wheel.fl.setpoint_rpm"].unit == "rpm"
    assert said["pose.x_m"].causality == "output"
    assert said["drive.enable"].start == "1"
    assert said["seed"].variability == "tunable"
    assert said["terms.dead_zone"].start == "3"
    gain = said["plant.controller.k_p"]
    assert (gain.causality, gain.variability, gain.unit) == (
        "parameter",
        "tunable",
        "%/rpm",
    )
    at_a_tick = {name for name, about in PLANT.items() if about.when == "tick"}
    left_out = {
        name
        for name in at_a_tick - said.keys()
        if not name.startswith("terms.friction_anisotropy")
    }
    assert left_out == {"terms.roller_slip", "sensors.battery.initial_charge"}
    by_name = said["kinematics.rotation_gain"]
    assert (by_name.start, by_name.min) == ("0", "0")
    assert by_name.description.endswith("; 0 is null")
    assert read_fmu(str(fmu[3]), fmu[3].parent).stores_state


def rows_of(fmu):
    """The drive as the importer takes it: step, value reference, value."""
    reference = {
        v.name: v.valueReference
        for v in read_model_description(str(fmu)).modelVariables
    }
    return [(tick, reference[name], value) for tick, name, value in drives()]


async def test_an_importer_in_c_gets_the_bits_too(fmu, tmp_path):
    ours, _ = await both(tmp_path, fmu[3], drives())
    library = importing.unpacked(tmp_path, fmu[3])
    copy = importing.run(
        importing.compiled(tmp_path), library, fmu[3], rows_of(fmu[3]), N
    )
    assert np.array_equal(ours, copy, equal_nan=True)


@pytest.mark.parametrize("version", [pytest.param(2, marks=pytest.mark.long), 3])
def test_any_compiler_makes_the_same_of_its_sources(fmu, tmp_path, version):
    """With none of the options that the export compiles with, and no header but those of C."""
    alone = exported(tmp_path, version, "--platforms", "none")
    assert validate_fmu(str(alone)) == []
    with zipfile.ZipFile(alone) as packed:
        assert not any(name.startswith("binaries/") for name in packed.namelist())
        packed.extractall(tmp_path)
    library = tmp_path / "robot.so"
    words = ["cc", "-w", "-shared", "-fPIC", "-o", library, "robot_fmu.c", "-lm"]
    subprocess.run(words, cwd=tmp_path / "sources", check=True)
    if version == 3:
        built = importing.run(
            importing.compiled(tmp_path), library, alone, rows_of(alone), N
        )
        packed = importing.unpacked(tmp_path, fmu[3])
        ours = importing.run(
            importing.compiled(tmp_path), packed, fmu[3], rows_of(fmu[3]), N
        )
        assert np.array_equal(built, ours, equal_nan=True)


async def test_on_aarch64_it_computes_the_same(tmp_path, fmu):
    """libm of the other processor may round differently: 1e-9 of what moves."""
    other = exported(tmp_path, 3, "--platforms", "x86_64-linux,aarch64-linux")
    ours, _ = await both(tmp_path, fmu[3], drives())
    before = ("qemu-aarch64", "-L", "/usr/aarch64-linux-gnu")
    program = importing.compiled(tmp_path, "aarch64-linux-gnu-gcc")
    library = importing.unpacked(tmp_path, other, "aarch64-linux")
    copy = importing.run(program, library, other, rows_of(other), N, before)
    difference = np.abs(ours - copy).max()
    print(f"largest difference {difference:.3g}")
    assert difference < 1e-9


@pytest.mark.long
@pytest.mark.parametrize("version", [2, 3])
def test_on_windows_it_needs_what_every_windows_has(tmp_path, version):
    path = exported(tmp_path, version, "--platforms", "x86_64-windows")
    assert validate_fmu(str(path)) == []
    with zipfile.ZipFile(path) as packed:
        (library,) = (n for n in packed.namelist() if n.endswith(".dll"))
        assert library.split("/")[1] == {2: "win64", 3: "x86_64-windows"}[version]
        packed.extract(library, tmp_path)
    said = subprocess.run(
        ["x86_64-w64-mingw32-objdump", "-p", tmp_path / library],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    needed = {line.split()[-1] for line in said.splitlines() if "DLL Name" in line}
    assert needed == {"KERNEL32.dll", "msvcrt.dll"}
    assert f"fmi{version}DoStep" in said


@pytest.mark.long
async def test_on_windows_it_computes_the_same(tmp_path, fmu):
    """Under Wine (Debian: wine64); the mathematical library is another one: 1e-9 of what moves."""
    other = exported(tmp_path, 3, "--platforms", "x86_64-windows")
    ours, _ = await both(tmp_path, fmu[3], drives())
    program = importing.compiled(tmp_path, "x86_64-w64-mingw32-gcc")
    library = importing.unpacked(tmp_path, other, "x86_64-windows")
    before = (
        "env",
        "WINEDEBUG=-all",
        f"WINEPREFIX={tmp_path / 'wine'}",
        "/usr/lib/wine/wine64",
    )
    copy = importing.run(program, library, other, rows_of(other), N, before)
    difference = np.abs(ours - copy).max()
    print(f"largest difference {difference:.3g}")
    assert difference < 1e-9


DRIVE = """
import sys
from fmpy import extract, read_model_description
from fmpy.fmi3 import FMU3Slave

path = sys.argv[1]
said = read_model_description(path)
vr = {v.name: v.valueReference for v in said.modelVariables}
folder = extract(path)
shown = [v.valueReference for v in said.modelVariables if v.causality == "output"]
def make():
    fmu = FMU3Slave(
        guid=said.guid, unzipDirectory=folder, modelIdentifier="robot", instanceName="r"
    )
    fmu.instantiate()
    begin(fmu)
    return fmu
def begin(fmu):
    fmu.enterInitializationMode(startTime=2.0)
    fmu.exitInitializationMode()
    fmu.setFloat64([vr["wheel.fl.setpoint_rpm"], vr["wheel.fr.setpoint_rpm"]], [40.0, -10.0])
def run(fmu, t, n, dt=0.001):
    for i in range(n):
        fmu.doStep(t + i * dt, dt)
    return fmu.getFloat64(shown)
a, b = make(), make()
first = run(a, 2.0, 600)
assert run(b, 2.0, 60, 0.01) == first, "a step of ten"
state = a.getFMUState()
packed = a.serializeFMUState(state)
second = run(a, 2.6, 500)
b.setFMUState(b.deserializeFMUState(packed))
assert run(b, 2.6, 500) == second, "a state of another instance"
a.setFMUState(state)
assert run(a, 2.6, 500) == second
a.terminate(); a.reset(); begin(a)
assert run(a, 2.0, 600) == first, "reset"
for wrong, words in (
    (lambda: a.doStep(2.6, 0.0015), "step"),
    (lambda: a.doStep(9.0, 0.001), "begin"),
    (lambda: a.setFloat64([vr["wheel.fl.setpoint_rpm"]], [float("nan")]), "nan"),
    (lambda: a.setFloat64([vr["terms.dead_zone"]], [1e300]), "range"),
    (lambda: a.setFloat64([vr["pose.x_m"]], [0.0]), "output"),
    (lambda: a.setFloat64([vr["plant.controller.k_p"]], [1e4]), "unstable"),
    (lambda: a.setFloat64([vr["plant.max_rpm"]], [0.0]), "above 0"),
    (lambda: a.setFloat64([vr["plant.icr_offset_m"]], [0.2]), "centre"),
    (lambda: a.setFloat64([vr["kinematics.yaw_sign"]], [0.5]), "sign"),
    (lambda: a.setFloat64([vr["plant.exclusive_twist"]], [0.5]), "flag"),
    (lambda: a.setFloat64([vr["plant.track_m"]], [0.0]), "null without a meaning"),
    (lambda: a.setFloat64([vr["terms.dead_zone"], vr["seed"]], [7.0, -1.0]), "half a group"),
    (lambda: a.deserializeFMUState(packed[:-8]), "short"),
    (lambda: a.deserializeFMUState(bytes(8) + packed[8:]), "layout"),
):
    try:
        wrong()
    except Exception:
        continue
    raise SystemExit(f"{words} was not refused")
assert a.getFloat64([vr["terms.dead_zone"], vr["plant.controller.k_p"]]) == [3.0, 13.513]
try:
    FMU3Slave(
        guid="{other}", unzipDirectory=folder, modelIdentifier="robot", instanceName="r"
    ).instantiate()
    raise SystemExit("a token was not looked at")
except Exception:
    pass
many = [make() for _ in range(100)]
assert all(run(m, 2.0, 600) == first for m in many)
print("done")
"""


def test_states_instances_reset_and_refusals_in_a_foreign_importer(fmu):
    done = subprocess.run(
        [sys.executable, "-c", DRIVE, fmu[3]],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.endswith("done\n"), done.stdout + done.stderr
    for sentence in (
        "a communication step of 0.0015",
        "a step begins at 9 s",
        "wheel.fl.setpoint_rpm: nan is outside -90 .. 90",
        "the serialised state is of another robot or damaged",
        "the wheel speed loop would be unstable",
        "plant.icr_offset_m must be below half the wheelbase",
        "this library is of the FMU {",
    ):
        assert sentence in done.stdout + done.stderr


def test_what_is_no_part_of_it_is_refused(fmu, tmp_path, capsys):
    for sections, words in (
        ({"mechatronic": {"enabled": True}}, "runs in MuJoCo, which is not part"),
        (
            {"blocks": [{"name": "copy", "fmu": str(fmu[3])}]},
            "own block 'copy' cannot be part of",
        ),
    ):
        configured(tmp_path, *sections.get("blocks", ()), **sections)
        out = tmp_path / "r.fmu"
        assert main(["fmu", "-c", str(tmp_path / "config.yaml"), "-o", str(out)]) == 78
        assert words in capsys.readouterr().err
        assert not out.exists()


def test_another_platform_is_named(tmp_path, capsys):
    words = ["fmu", "-o", str(tmp_path / "r.fmu"), "--platforms", "riscv-linux"]
    configured(tmp_path)
    assert main([*words, "-c", str(tmp_path / "config.yaml")]) == 1
    assert (
        "platforms are x86_64-linux, aarch64-linux, x86_64-windows"
        in capsys.readouterr().err
    )

"""The robot as an FMU: description, C sources and the compiled libraries, in one zip."""

import hashlib
import os
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilserver.cache import cache_folder
from hilserver.errors import ConfigError, FailedError
from hilserver.fmu import variables
from hilserver.fmu.c_source import c_number
from hilserver.fmu.description import MISSING
from hilserver.fmu.machine_code import CARRY, PACK, PARTS, PORTABLE
from hilserver.kernel import Composition
from hilserver.plant.layout import RING, Inputs, Outputs, Parameters, State
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.physical import REASONS, Physical, physical
from hilserver.program import children
from hilserver.program.whole_file import writing

COMPILERS: Final[Mapping[str, tuple[str, str]]] = {
    "x86_64-linux": ("gcc", "gcc"),
    "aarch64-linux": ("aarch64-linux-gnu-gcc", "gcc-aarch64-linux-gnu"),
    "x86_64-windows": ("x86_64-w64-mingw32-gcc", "gcc-mingw-w64-x86-64-win32"),
}
"""Compiler for each platform, and the Debian package that provides it."""
_FOLDERS: Final = {2: {"x86_64-linux": "linux64", "x86_64-windows": "win64"}, 3: {}}
_EXPORTED: Final = "{ global: fmi2*; fmi3*; local: *; };\n"
_HEADERS: Final = {
    2: ("TypesPlatform", "FunctionTypes"),
    3: ("PlatformTypes", "FunctionTypes"),
}
_OPTIONS: Final = ("-O3", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math")
"""None of these changes a bit of the results."""
_MAIN: Final = "robot_fmu.c"  # includes all other sources: it alone is compiled
_HERE: Final = Path(__file__).parent


def export(
    path: Path,
    composition: Composition,
    robot: RobotParameters,
    base_period_ns: int,
    version: int,
    platforms: Sequence[str],
) -> None:
    """Write the FMU of a robot.

    ConfigError if the robot has parts that an FMU cannot have; FailedError if a compiler is missing
    or fails, or the disk does not take the file.

    Parameters
    ----------
    composition, robot, base_period_ns
        As in an assembly.
    version : int
        2 or 3.
    """
    _check(composition, platforms)
    tunable = variables.tunables(robot)
    header = f"#define FMI {version}\n" + _header(
        composition, robot, tunable, base_period_ns
    )
    token = f"{{{hashlib.sha256(header.encode()).hexdigest()[:32]}}}"
    header += f'#define TOKEN "{token}"\n#define LAYOUT 0x{token[1:16]}ULL\n'
    text = variables.description(
        version, composition.table, tunable, base_period_ns * 1e-9, token
    )
    with tempfile.TemporaryDirectory(prefix="hilserver-fmu-") as name:
        folder = Path(name)
        sources = _sources(folder / "sources", header, version)
        libraries = {p: _linked(folder, p) for p in platforms}
        with (
            writing(path) as out,
            zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as packed,
        ):
            packed.writestr("modelDescription.xml", text)
            for file in sources:
                packed.write(file, f"sources/{file.name}")
            for platform, library in libraries.items():
                place = _FOLDERS[version].get(platform, platform)
                packed.write(library, f"binaries/{place}/robot{library.suffix}")


def _check(composition: Composition, platforms: Sequence[str]) -> None:
    if composition.body is not None:
        raise ConfigError(
            "the mechatronic model runs in MuJoCo, which is not part of the robot's FMU; set"
            " mechatronic.enabled: false"
        )
    if composition.blocks:
        raise ConfigError(
            f"own block '{composition.blocks[0].name}' cannot be part of the robot's FMU; leave it"
            f" out"
        )
    if find_spec("fmpy") is None:
        raise ConfigError(f"the export {MISSING}")
    for platform in platforms:
        if platform not in COMPILERS:
            known = ", ".join(COMPILERS)
            raise FailedError(
                f"there is no machine code for {platform!r}; platforms are {known}"
            )
        compiler, package = COMPILERS[platform]
        if shutil.which(compiler) is None:
            raise FailedError(
                f"{platform}: needs {compiler}; install the package {package}, or take the sources"
                " alone with --platforms none"
            )


def _sources(folder: Path, header: str, version: int) -> list[Path]:
    """Write all sources to a folder."""
    folder.mkdir()
    (folder / "robot.h").write_text(header, encoding="utf-8")
    portable = (
        os.environ | PORTABLE | {"HILSERVER_CACHE_DIR": str(cache_folder("portable"))}
    )
    _run(
        children.python("-m", "hilserver.fmu.machine_code", str(folder / "kernels.h")),
        portable,
    )
    for name in (_MAIN, f"fmi{version}_calls.h"):
        shutil.copy(_HERE / name, folder)
    of_fmi = Path(find_spec("fmpy").origin).parent / "c-code"  # type: ignore[union-attr,arg-type]
    for name in _HEADERS[version]:
        shutil.copy(of_fmi / f"fmi{version}{name}.h", folder)
    if version == 3:  # 2.0 lists them in the model description
        (folder / "buildDescription.xml").write_text(variables.BUILD, encoding="utf-8")
    return sorted(folder.iterdir())


def _linked(folder: Path, platform: str) -> Path:
    """Return the shared library for a platform."""
    if platform.endswith("-windows"):
        library = folder / f"{platform}.dll"
        link = "-static-libgcc -Wl,--export-all-symbols,-s"
    else:
        (folder / "exported.map").write_text(_EXPORTED, encoding="utf-8")
        library = folder / f"{platform}.so"
        script = folder / "exported.map"
        link = f"-Wl,--version-script={script},-z,defs,-z,noexecstack,-s"
    options = ["-std=gnu11", *_OPTIONS, "-fPIC", "-shared", "-w"]
    source = str(folder / "sources" / _MAIN)
    target = ["-o", str(library), *link.split(), "-lm"]
    command = [COMPILERS[platform][0], *options, source, *target]
    _run(command, os.environ)
    return library


def _run(command: Sequence[str], environment: Mapping[str, str]) -> None:
    done = subprocess.run(  # noqa: S603 - of ours
        command,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise FailedError(f"{Path(command[0]).name} failed: {last}")


def _header(
    composition: Composition,
    robot: RobotParameters,
    tunable: Sequence[variables.Tunable],
    base_period_ns: int,
) -> str:
    """Return robot.h: everything that differs between robots."""
    table = composition.table
    sizes = _sizes(composition, tunable)
    ticks = {
        n: round(s * 1e9 / base_period_ns) for n, s in composition.periods_s.items()
    }
    schedule = [
        f"{{{PARTS.index(part.name)}, {ticks[name]}}}"
        for name in composition.slices
        for part in composition.parts
        if part.slice == name
    ]
    numbered = enumerate(variables.inputs(table))
    taken = [_row(s.name, i, s.low, s.high) for i, s in numbered]
    tuned = [
        _row(t.about.name, t.place, t.low, t.high, t.about.nullable, t.about.is_flag)
        for t in tunable
    ]
    why = ", ".join(f'"{REASONS.get(code, "")}"' for code in range(max(REASONS) + 1))
    initial = _array("U_0", np.array([s.initial for s in variables.inputs(table)]))
    lines = [
        *(f"#define {name} {value}" for name, value in sizes.items()),
        f"#define STEP_S {c_number(base_period_ns * 1e-9)}",
        "typedef struct { const char *name; int place; double low, high; int has_null, is_flag; }"
        " Number;",
        f"static const Number INPUTS[] = {{{', '.join(taken)}}};",
        f"static const Number TUNABLE[] = {{{', '.join(tuned)}}};",
        f"static const char *const WHY[] = {{{why}}};",
        f"static const struct {{ int which, every; }} PARTS[] = {{{', '.join(schedule)}}};",
        _array("V_0", _numbers(robot)),
        _array("P_0", composition.parameters.numbers),
        _array("X_0", composition.state.numbers),
        initial,
        _array("HALL", composition.hall.ravel()),
        _soundness(),
    ]
    return "\n".join(lines) + "\n"


def _sizes(
    composition: Composition, tunable: Sequence[variables.Tunable]
) -> dict[str, int]:
    n_inputs = len(variables.inputs(composition.table))
    return {
        "N_V": Physical.n_words,
        "N_P": Parameters.n_words,
        "N_X": State.n_words,
        "N_U": Inputs.n_words,
        "N_Y": Outputs.n_words,
        "N_INPUT": n_inputs,
        "N_TUNABLE": len(tunable),
        "CARRY": CARRY,
        "PACK": PACK,
        "FIRST_INPUT": variables.FIRST_INPUT,
        "FIRST_OUTPUT": variables.FIRST_OUTPUT,
        "FIRST_TUNABLE": variables.FIRST_TUNABLE,
    }


def _row(name: str, place: int, low: float, high: float, *kinds: bool) -> str:
    bounds = f"{c_number(float(low))}, {c_number(float(high))}"
    last = "".join(f", {int(kind)}" for kind in kinds)
    return f'{{"{name}", {place}, {bounds}{last}}}'


def _numbers(robot: RobotParameters) -> NDArray[np.float64]:
    v = Physical.zeros()
    for name, value in vars(physical(robot)).items():
        v[name] = value
    numbers: NDArray[np.float64] = v.numbers
    return numbers


def _array(name: str, numbers: NDArray[np.float64]) -> str:
    values = ", ".join(c_number(float(v)) for v in np.atleast_1d(numbers)) or "0"
    return f"static const double {name}[] = {{{values}}};"


def _soundness() -> str:
    """Return the C function that tells whether a state can be continued from."""
    heads = ("setpoint_head", "imu_head", "nav_head")
    counts = ("imu_count", "nav_count")
    at = State.where
    most = RING
    tests = [f"x[{at(n).start}] >= 0 && x[{at(n).start}] < {most}" for n in heads]
    tests += [f"x[{at(n).start}] >= 0 && x[{at(n).start}] <= {most}" for n in counts]
    return f"static int is_sound(const double *x) {{ return {' && '.join(tests)}; }}"

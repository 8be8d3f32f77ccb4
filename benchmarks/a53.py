"""Instructions of a tick on aarch64, beside x86-64: what an estimate for the IOT2050 starts from.

The robot's FMU, whose kernels are those of the paced step, runs in qemu's user mode, and a plug-in
counts what it executes. What a run of ten ticks costs besides is subtracted with a shorter run. No
time is measured: an emulator says nothing about time (docs/how-to/container.md has the estimate).
"""

import argparse
import subprocess
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from fmpy import read_model_description

from hilserver.bench.report import Result
from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.errors import FailedError
from hilserver.fmu.export import export
from hilserver.plant.reference.cases import cases

HERE: Final = Path(__file__).parent
PLUGIN, IMPORTER = (
    HERE / "count_instructions.c",
    HERE.parent / "tests" / "fmu" / "importer.c",
)
MACHINES: Final[Mapping[str, tuple[str, tuple[str, ...]]]] = {
    "x86_64": ("gcc", ("qemu-x86_64",)),
    "aarch64": (
        "aarch64-linux-gnu-gcc",
        ("qemu-aarch64", "-L", "/usr/aarch64-linux-gnu"),
    ),
}
ROBOTS: Final[Mapping[str, Mapping[str, Any]]] = {
    "default": {},
    "all_terms": {
        "plant": {"terms": cases()["everything"]},
        "sensors": {"nav": {"enabled": True}},
    },
}
TICKS_PER_CALL, SHORT, LONG = 10, 100, 600
SPEEDS: Final = {"fl": 40.0, "rl": 40.0, "fr": -30.0, "rr": -30.0}


def add_arguments(_parser: argparse.ArgumentParser) -> None:
    """Add nothing."""


def run(_args: argparse.Namespace) -> list[Result]:
    """Count; return ``instructions_default`` and ``instructions_all_terms`` of a tick."""
    results = []
    for name, sections in ROBOTS.items():
        with tempfile.TemporaryDirectory() as folder:
            found = _per_tick(Path(folder), Config.model_validate(sections))
        other = found["x86_64"]
        about = "x86-64"
        ratio = found["aarch64"] / other
        results.append(
            Result(
                f"instructions_{name}",
                found["aarch64"],
                "1",
                other,
                about,
                ratio,
                found,
            )
        )
    return results


def _per_tick(folder: Path, config: Config) -> dict[str, float]:
    assembly = assemble_config(config)
    fmu, platforms = folder / "robot.fmu", [f"{machine}-linux" for machine in MACHINES]
    export(
        fmu, assembly.composition, assembly.robot, assembly.base_period_ns, 3, platforms
    )
    said = read_model_description(str(fmu))
    reference = {v.name: v.valueReference for v in said.modelVariables}
    rows = [(0, reference[f"wheel.{w}.setpoint_rpm"], rpm) for w, rpm in SPEEDS.items()]
    np.asarray(rows, dtype=float).tofile(folder / "rows")
    plugin = folder / "count.so"
    _run("cc", "-shared", "-fPIC", "-O1", "-o", plugin, PLUGIN)

    found = {}
    for machine, (compiler, emulator) in MACHINES.items():
        importer, library = folder / f"importer-{machine}", folder / f"{machine}.so"
        _run(compiler, "-w", "-O2", "-o", importer, IMPORTER)
        with zipfile.ZipFile(fmu) as packed:
            library.write_bytes(packed.read(f"binaries/{machine}-linux/robot.so"))
        counts = []
        for calls in (SHORT, LONG):
            log, step_s = (
                folder / "log",
                TICKS_PER_CALL * assembly.base_period_ns * 1e-9,
            )
            counting = ("-plugin", plugin, "-d", "plugin", "-D", log)
            asked = (
                library,
                said.guid,
                calls,
                step_s,
                len(rows),
                folder / "rows",
                folder / "out",
            )
            _run(*emulator, *counting, importer, *asked)
            counts.append(int(log.read_text(encoding="utf-8").split()[-1]))
        found[machine] = (counts[1] - counts[0]) / (TICKS_PER_CALL * (LONG - SHORT))
    return found


def _run(*words: object) -> None:
    try:
        subprocess.run(  # noqa: S603
            list(map(str, words)), check=True, capture_output=True, timeout=600
        )
    except FileNotFoundError:
        raise FailedError(
            f"{words[0]} is not installed: 'make test-tools' installs it"
        ) from None
    except subprocess.CalledProcessError as error:
        raise FailedError(f"{words[0]}: {error.stderr.decode()[-500:]}") from None

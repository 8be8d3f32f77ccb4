"""The robot as an FMU compared with the daemon's own step, and foreign FMUs beside the paced plant.

A step of the FMU, called through its function pointers, and the same kernels as the daemon compiles
them for this processor run in alternating blocks, with all terms on. Foreign FMUs run paced, in the
thread and in a process of their own, after a drive without any; one that misbehaves on demand
(`tests/fmu/model.c`) does so beside the plant. ``--models`` takes a folder of FMUs, such as the
Reference FMUs of the Modelica Association.
"""

import argparse
import asyncio
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.fmu_models import Drive, Model, beside
from hilserver.bench.report import Result
from hilserver.compiled import kernel
from hilserver.config.root import Config
from hilserver.daemon.assembly import Assembly, assemble_config
from hilserver.errors import ConfigError, FailedError
from hilserver.fmu import calls
from hilserver.fmu.description import read_fmu
from hilserver.fmu.export import export
from hilserver.fmu.library import Instance
from hilserver.fmu.wiring import wire
from hilserver.monitoring.logging_setup import setup_logging
from hilserver.plant.battery import battery_step
from hilserver.plant.imu import imu_step
from hilserver.plant.layout import Inputs, Outputs, Status
from hilserver.plant.nav import nav_step
from hilserver.plant.reference.cases import cases
from hilserver.plant.robot import robot_step
from hilserver.plant.shield import shield_step
from hilserver.plant.tof import tof_step
from hilserver.program.progress import Progress
from tests.fmu.rig import make

BLOCKS, STEPS, MOST = 401, 4_000, 1.2
DT_S = 0.001
SPEEDS: Final = {"fl": 60.0, "rl": 55.0, "fr": -40.0, "rr": -45.0}
MISCHIEF: Final = {
    "divides by zero": 2,
    "segfaults": 3,
    "loops for ever": 4,
    "exits": 6,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    parser.add_argument("--models", type=Path, metavar="FOLDER", help="FMUs of others")
    parser.add_argument(
        "--seconds", type=float, default=5.0, help="of every drive (default 5)"
    )
    parser.add_argument(
        "--priority", type=int, default=80, help="SCHED_FIFO (default 80)"
    )


def run(args: argparse.Namespace) -> list[Result]:
    """Measure; return ``fmu_step_ns``, the missed ticks of every drive and the replays."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        return [_cost(folder), *asyncio.run(_drives(args, folder))]


@kernel()
def _daemon(
    p: Any,
    x: Any,
    u: Any,
    y: Any,
    q: Any,
    hall: Any,
    every: Any,
    first: int,
    ticks: int,
) -> None:
    for tick in range(first, first + ticks):
        robot_step(p, x, u, y, q)
        if tick % every[0] == 0:
            imu_step(p, x, u, y, q)
        if tick % every[1] == 0:
            battery_step(p, x, u, y, q)
        if tick % every[2] == 0:
            shield_step(p, x, u, y, q)
        if tick % every[3] == 0:
            tof_step(p, x, u, y, q, hall)
        if tick % every[4] == 0:
            nav_step(p, x, u, y, q)


def _cost(folder: Path) -> Result:
    sections = {
        "plant": {"terms": cases()["everything"]},
        "sensors": {"nav": {"enabled": True}},
    }
    assembly = assemble_config(Config.model_validate(sections))
    path = folder / "robot.fmu"
    base_ns = assembly.base_period_ns
    export(path, assembly.composition, assembly.robot, base_ns, 3, ["x86_64-linux"])
    programs = {"fmu": _exported(path), "daemon": _own(assembly)}
    samples: dict[str, list[float]] = {name: [] for name in programs}
    for block in range(BLOCKS + 1):
        for name, program in programs.items():
            start_ns = time.perf_counter_ns()
            program(block * STEPS)
            samples[name].append((time.perf_counter_ns() - start_ns) / STEPS)
    pairs = np.array([samples["fmu"][1:], samples["daemon"][1:]])
    fmu, daemon = np.median(pairs, axis=1)
    # of neighbours: other load affects both
    ratio = float(np.median(pairs[0] / pairs[1]))
    text = f"the daemon's kernels; at most {MOST}"
    return Result("fmu_step_ns", float(fmu), "ns", float(daemon), text, ratio, samples)


def _exported(path: Path) -> Callable[[int], None]:
    """Return a function that runs a block of steps of the FMU."""
    fmu = read_fmu(str(path), path.parent)
    signals = {f"wheel.{w}.setpoint_rpm": "" for w in SPEEDS}
    wiring = wire(fmu, signals, {"pose.x_m": "x"}, {})
    instance = Instance(fmu, wiring, "robot", 0)
    u, y, x = np.array(list(SPEEDS.values())), np.zeros(1), instance.initial
    p = np.array([v.start for v in wiring.parameters])

    def run_block(_: int) -> None:
        if calls.advance(STEPS, DT_S, u, y, x, p, instance.addresses) > 0:
            raise FailedError(f"the FMU failed: {instance.message}")

    return run_block


def _own(assembly: Assembly) -> Callable[[int], None]:
    """Return a function that runs a block of the daemon's kernels, as its slices do."""
    made = assembly.composition
    ticks = {
        n: round(s * 1e9 / assembly.base_period_ns) for n, s in made.periods_s.items()
    }
    of_part = {part.name: ticks[part.slice] for part in made.parts}
    every = np.array(
        [of_part[name] for name in ("imu", "battery", "shield", "tof", "nav")]
    )
    u, y, q = Inputs.zeros(), Outputs.zeros(), Status.zeros()
    u.enable = 1.0
    u.setpoint[:] = list(SPEEDS.values())
    p, x, hall = made.parameters, made.state, made.hall
    return lambda first: _daemon(p, x, u, y, q, hall, every, first, STEPS)


async def _drives(args: argparse.Namespace, folder: Path) -> list[Result]:
    """Drive with every model; return the missed ticks, compared with a drive without a model."""
    setup_logging("ERROR")
    idle = await beside(None, folder, args.seconds, args.priority)
    results, asked, progress = (
        [],
        [],
        Progress(lambda: "stopped before it was measured"),
    )
    models = sorted(args.models.rglob("*.fmu")) if args.models else []
    models.append(make(folder / "lag.fmu", 3))
    for number, path in enumerate(models):
        progress("driving beside FMUs", number / len(models))
        for process in (False, True):
            name = f"{'.'.join(path.parts[-2:])}_{'beside' if process else 'here'}"
            model = Model(path, process=process)
            try:
                drive = await beside(
                    model, folder, args.seconds, args.priority, replay=True
                )
            except ConfigError as error:
                results.append(Result(f"{name}_refused", 1, "1", None, str(error)))
                continue
            results.append(_missed(name, drive, idle))
            asked.append(drive.replayed)
    progress.end()
    for words, mischief in MISCHIEF.items():
        model = Model(folder / "lag.fmu", True, {"mischief": mischief, "atStep": 1000})
        drive = await beside(model, folder, args.seconds, args.priority)
        if drive.state != "safe":
            raise FailedError(
                f"one that {words} has not led to the safe state: {drive.reason}"
            )
        results.append(_missed(words.replace(" ", "_"), drive, idle))
    able = asked.count("equal") + asked.count("differs")
    text = (
        f"recordings; {asked.count('late')} with late answers, which are not replayed"
    )
    equal = asked.count("equal")
    return [*results, Result("fmu_replayed_to_the_bit", equal, "1", able, text)]


def _missed(name: str, drive: Drive, idle: Drive) -> Result:
    text = f"without it; {drive.ticks} ticks, {drive.replayed or drive.reason}"
    return Result(
        f"{name}_missed", drive.missed, "1", idle.missed, text, None, vars(drive)
    )

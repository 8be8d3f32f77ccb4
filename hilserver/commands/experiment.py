"""Drive an experiment of the thesis again, and put both models beside what was measured.

Without a NAME it lists them. A simulated robot drives the experiment's scenario, unless --measured
names a recording of a real one; the kinematic and the mechatronic model then run on the wheel
speeds of the recording. DIR gets report.html with the thesis's figures, and their curves as CSV.
"""

import argparse
from pathlib import Path
from typing import Final

from hilserver.commands.options import add_mapping, warn
from hilserver.diagnosis.output import write_files
from hilserver.errors import EXIT_DONE, FailedError, UsageError
from hilserver.experiment import tables
from hilserver.experiment.drive import RECORDING, as_it_was, body_of, record, robot_of
from hilserver.experiment.gaps import BesideModels, beside_models
from hilserver.experiment.identification import Identified, identify
from hilserver.experiment.models import run_models
from hilserver.experiment.report.page import REPORT, reading, render, sentence, third_of
from hilserver.experiment.thesis import (
    EXPERIMENTS,
    ROBOT,
    Experiment,
    experiment_of,
    folder,
)
from hilserver.measured.frames import Sampling
from hilserver.measured.machine import machine
from hilserver.measured.reading import read_measured
from hilserver.monitoring.logging_setup import setup_logging
from hilserver.program.progress import Progress

EXAMPLE = (
    "hilserver experiment 5.6.2 --measured drive.mcap --mapping iotbot_5_6 -o report"
)
FILES: Final = (
    *(RECORDING, REPORT, "wheels.csv", "kinematic.csv", "mechatronic.csv", "gaps.csv"),
    *(f"measured_{channel}.csv" for channel in ("x", "y", "yaw", "turn")),
)


def _known(name: str) -> str:
    """Return a name, which is a mistake in the command line if there is no such experiment."""
    try:
        return experiment_of(name).name
    except FailedError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    parser.add_argument(
        "name",
        nargs="?",
        type=_known,
        metavar="NAME",
        help=f"one of {', '.join(EXPERIMENTS)}; none: list them",
    )
    parser.add_argument(
        "--measured",
        type=Path,
        metavar="LOG",
        help="recording of the real robot in this experiment; default: a simulated robot drives it",
    )
    add_mapping(parser)
    parser.add_argument(
        "-c",
        "--config",
        type=Path,
        metavar="FILE",
        help="configuration of both models and of the simulated robot; default: the thesis's robot",
    )
    parser.add_argument(
        "-o", "--out", type=Path, metavar="DIR", help="folder; default: experiment-NAME"
    )


def run(args: argparse.Namespace) -> int:
    """Drive, compare and write the report; return 0, or 2 if the recording cannot be read."""
    if args.name is None and args.measured is not None:
        names = ", ".join(EXPERIMENTS)
        raise UsageError(f"{args.measured}: name its experiment, too: one of {names}")
    if args.name is None:
        for known in EXPERIMENTS.values():
            print(f"{known.name:8}{known.title}")
        return EXIT_DONE

    experiment = experiment_of(args.name)
    out = args.out or Path(f"experiment-{experiment.name}")
    if out.exists() and not out.is_dir():
        raise FailedError(f"{out}: is a file; name a folder for the report")
    setup_logging("ERROR")
    with Progress(
        lambda: f"stopped before the report was written; {out} is not whole"
    ) as progress:
        both, identified = _report(experiment, args, out, progress)
    warn(both.courses.missing or None, *both.courses.notes)
    print(reading(both))
    print(sentence(both.gaps()))
    for row in identified.rows:
        print(f"{row.what}: {row.here}")
    print(f"The report is {out / REPORT}")
    return EXIT_DONE


def _report(
    experiment: Experiment, args: argparse.Namespace, out: Path, progress: Progress
) -> tuple[BesideModels, Identified]:
    """Write all files; return what the report shows."""
    robot = robot_of(args.config or folder() / ROBOT)
    write_files(out, {}, FILES)
    path = args.measured or out / RECORDING
    if args.measured is None:
        record(experiment, robot, path, progress)
    progress("reading the recording", 0.0)
    log = read_measured([path], args.mapping, Sampling.of(robot.config))
    if args.measured is None:
        log = as_it_was(log)

    progress("running both models", 0.0)
    plant = machine(log, robot.robot)
    courses = run_models(log, plant, body_of(robot.config, plant))
    both = beside_models(courses, experiment.channels)
    identified = identify(experiment, courses.log, plant)

    third = third_of(args.measured, has_body=robot.config.mechatronic.turns_wheels)
    sources = [f"{source.file}, SHA-256 {source.sha256[:16]}" for source in log.sources]
    driven_by = experiment.drive.name if args.measured is None else "the recording"
    configuration = (
        "Configuration",
        f"{args.config or ROBOT}, SHA-256 {robot.config.sha256[:16]}",
    )
    gain = ("K_om of the kinematic model", f"{plant.k_om:.4g} 1/m")
    origin = [
        ("Wheel speeds and pose", "; ".join(sources)),
        ("Driven by", driven_by),
        configuration,
        gain,
    ]
    page = render(experiment, both, third, identified, origin)
    write_files(out, tables.files(both) | {REPORT: page})
    return both, identified

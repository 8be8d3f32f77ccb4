"""Say where the robot was, from a log of its wheels, gyro and navigation: filter, or smoother.

The filter knows the plant's kinematics with the terms of the configuration and of a patch. Its
noise is fitted to the log, beginning with what a diagnosis has found (--findings), or with what the
configured sensors say. OUT is a log
of the signals estimate.*; beside it stands a picture of the path, of the same name with .svg.
"""

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hilserver.commands.observing import (
    MOST_NIS,
    STATE,
    Observed,
    doubts,
    mean_nis,
    path_picture,
    sentences,
)
from hilserver.commands.options import add_config, add_mapping, add_out, add_patch, warn
from hilserver.commands.patching import assembled
from hilserver.config.observer import constants_of, load_found
from hilserver.errors import EXIT_DONE, ConfigError, FailedError, UsageError
from hilserver.logs import Log
from hilserver.logs.writing import check_suffix, write_log
from hilserver.measured.frames import Sampling
from hilserver.measured.observed import series_of
from hilserver.measured.reading import read_measured
from hilserver.observer.log_noise import fitted, inflated
from hilserver.observer.offline import run as run_filter
from hilserver.observer.smoother import smooth
from hilserver.plant.errors import PlantError
from hilserver.plant.packing import pack
from hilserver.program.whole_file import writing
from hilserver.signals import Ranges, robot_table

EXAMPLE = "hilserver observe run.csv -c config.yaml --findings diagnosis/findings.json -o where.csv"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    parser.add_argument("log", type=Path, metavar="LOG", help="log of the robot")
    add_config(parser)
    add_patch(parser)
    add_mapping(parser)
    parser.add_argument(
        "--findings",
        type=Path,
        metavar="FILE",
        help="findings.json of a diagnosis: noise, and latency of the navigation",
    )
    add_out(parser, "OUT", "log to write, .csv or .mcap")
    parser.add_argument(
        "--smooth",
        action="store_true",
        help="use later samples, too: the best path in hindsight",
    )
    parser.add_argument(
        "--inflate",
        action="store_true",
        help=f"where the squared innovations are over {MOST_NIS:g} times their covariance, make all"
        " variances that much larger",
    )


def run(args: argparse.Namespace) -> int:
    """Observe; return 0, 1 if it cannot be smoothed, or 2 if the log cannot be read."""
    check_suffix(args.out)
    if args.out.exists() and args.log.exists() and args.out.samefile(args.log):
        raise UsageError(f"{args.out}: is the log itself; choose another file")
    assembly = assembled(args)
    robot = assembly.robot
    found = None if args.findings is None else load_found(args.findings)
    try:
        c = constants_of(robot, found)
    except PlantError as error:
        raise ConfigError(f"{args.findings or args.config}: {error}") from None
    log = read_measured([args.log], args.mapping, Sampling.of(assembly.config))
    warn(*log.notices)
    p = pack(robot)
    late_s = 0.0 if found is None else found.nav_late_s
    series = [series_of(log, span, robot, late_s) for span in range(len(log.spans))]

    given = c
    c = fitted(p, c, series)
    courses = [run_filter(p, c, one) for one in series]
    times = mean_nis(courses)
    too_sure = times > MOST_NIS
    if too_sure and args.inflate:
        c = inflated(c, times)
        courses = [run_filter(p, c, one) for one in series]
    elif too_sure and args.smooth:
        raise FailedError(
            f"{args.log}: the squared innovations are {times:.1f} times their covariance: the"
            " filter does not know this robot, and its smoothed path would be no better; 'hilserver"
            " diagnose' finds out why, and --inflate makes all variances that much larger"
        )

    spans = []
    for span, one, course in zip(log.spans, series, courses, strict=True):
        estimate = course.estimate
        covariance = course.covariance
        known = np.flatnonzero(course.shown[:, STATE] > 0.0)
        if args.smooth and len(known):
            estimate, covariance = smooth(p, c, one, course, int(known[0]))
        spans.append(Observed(span.number, one, course, estimate, covariance))
    _write(args.out, spans, path_picture(p, c, spans))
    if too_sure:
        print(doubts(times, inflates=args.inflate))
    print(sentences(p, given, c, spans))
    return EXIT_DONE


def _write(out: Path, spans: list[Observed], picture: str) -> None:
    names = [s.name for s in robot_table(Ranges(1.0, 1.0, 1.0), observer=True)
             if s.name.startswith("estimate.")]  # fmt: skip
    shown: NDArray[np.float64] = np.concatenate([one.signals for one in spans])
    t_s = np.concatenate([one.series.wheels[:, 0] for one in spans])
    numbers = [np.full(len(s.series.wheels), s.number) for s in spans]
    segment = np.concatenate(numbers)
    columns = dict(zip(names, shown.T, strict=True))
    log = Log(
        path=out,
        t_s=t_s,
        segment=segment,
        block=None,
        columns=columns,
    )
    drawing = out.with_suffix(".svg")
    with writing(out, out.suffix) as table, writing(drawing) as drawn:
        write_log(log, table)
        drawn.write_text(picture, encoding="utf-8")

"""Before an experiment: what its manoeuvre can show, how small, and what it cannot tell apart.

Replays the set-points of a log or a scenario, adds the noise of usual sensors, and asks what a
diagnosis could find. Writes plan.json, plan.html, and a better manoeuvre as a scenario,
manoeuvre.yaml, that 'hilserver run --scenario' and the test kit execute.
"""

import argparse
import os
import re
from pathlib import Path

from hilserver.commands.options import (
    SEED,
    add_config,
    add_mapping,
    add_out,
    comma_names,
    config_path,
    number,
)
from hilserver.daemon.assembly import assemble
from hilserver.diagnosis.output import write_files
from hilserver.diagnosis.plan.manoeuvre import LONGEST_PLAN_S, SHORTEST_S
from hilserver.diagnosis.plan.null_log import ALL, GROUPS
from hilserver.diagnosis.plan.planning import ROOM_M, SCENARIO, Wish, plan
from hilserver.diagnosis.plan.text import lines
from hilserver.diagnosis.report.plan_page import PAGE, render_plan
from hilserver.errors import EXIT_DONE, FailedError
from hilserver.program.progress import Progress

EXAMPLE = "hilserver plan drive.yaml -c config.yaml --duration 120 --room 5x5 -o plan"
SIDES_M = (1.0, 1000.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    parser.add_argument(
        "manoeuvre",
        type=Path,
        metavar="MANOEUVRE",
        help="scenario (.yaml), or log of set-points",
    )
    add_config(parser)
    add_mapping(parser)
    add_out(parser, "DIR", "folder for the plan")
    parser.add_argument(
        "--channels",
        type=_channels,
        metavar="NAMES",
        help=f"what will be recorded besides set-points, out of {','.join(GROUPS)} or signal names;"
        f" default: what the log has; for a scenario, all",
    )
    parser.add_argument(
        "--rate",
        type=number(1.0, 1000.0, "rate (1 .. 1000 Hz)"),
        default=50.0,
        metavar="HZ",
        help="rows per second; default: 50",
    )
    parser.add_argument(
        "--duration",
        type=number(SHORTEST_S, LONGEST_PLAN_S, "duration (2 .. 3600 s)"),
        metavar="S",
        help="duration of the better manoeuvre; default: that of MANOEUVRE",
    )
    parser.add_argument(
        "--room",
        type=_room,
        default=ROOM_M,
        metavar="AxB",
        help="sides of the free floor in m; the robot starts in the middle; default: 5x5",
    )
    parser.add_argument(
        "--seed", type=SEED, default=0, help="seed of the noise; default: 0"
    )
    parser.add_argument(
        "--satellites",
        type=number(0.001, 100.0, "standard deviation (0.001 .. 100 m)"),
        metavar="M",
        help="the position comes from satellites, with this standard deviation and no heading",
    )


def run(args: argparse.Namespace) -> int:
    """Plan; print what the manoeuvre shows and write the files."""
    if args.out.exists() and not args.out.is_dir():
        raise FailedError(f"{args.out}: is a file; name a folder for the plan")
    jobs = os.cpu_count() or 1
    wish = Wish(
        manoeuvre=args.manoeuvre,
        mapping=args.mapping,
        channels=args.channels,
        rate_hz=args.rate,
        duration_s=args.duration,
        room_m=args.room,
        seed=args.seed,
        satellites_m=args.satellites,
        jobs=jobs,
    )
    with Progress(
        lambda: "stopped before the plan was finished: nothing was written"
    ) as progress:
        document, files = plan(wish, assemble(config_path(args)), progress)
    write_files(args.out, files | {PAGE: render_plan(document)})
    print("\n".join(lines(document)))
    print(
        f"The manoeuvre to drive is {args.out / SCENARIO}; the plan as a page is {args.out / PAGE}"
    )
    return EXIT_DONE


def _channels(text: str) -> tuple[str, ...]:
    wanted: set[str] = set()
    for word in comma_names(text):
        if word in GROUPS:
            wanted |= set(GROUPS[word])
        elif word in ALL:
            wanted.add(word)
        else:
            known = ", ".join(GROUPS)
            raise argparse.ArgumentTypeError(
                f"{word!r} is neither one of {known} nor a measured signal"
            )
    return tuple(name for name in ALL if name in wanted)


def _room(text: str) -> tuple[float, float]:
    match = re.fullmatch(r"([\d.]+)[x\u00d7]([\d.]+)", text)
    if match is None:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a room; write its sides in m, as 5x5"
        )
    sides = [number(*SIDES_M, "side (1 .. 1000 m)")(side) for side in match.groups()]
    return sides[0], sides[1]

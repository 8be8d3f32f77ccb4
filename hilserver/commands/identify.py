"""Identify single figures from a log: K_om, a step response, an update rate, a dead zone, noise.

These are the classical methods, each with an interval of 95 % that holds under autocorrelation.
What is wrong with a whole simulation, and why, is the question of hilserver diagnose.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hilserver.commands.options import (
    POSITIVE,
    add_config,
    add_mapping,
    config_path,
    warn,
)
from hilserver.daemon.assembly import assemble
from hilserver.errors import EXIT_DONE
from hilserver.identify import text
from hilserver.identify.consistency import check_sides, check_sign
from hilserver.identify.dead_zone import identify_dead_zone
from hilserver.identify.resting_noise import identify_noise
from hilserver.identify.rotation import identify_rotation
from hilserver.identify.step_response import INPUTS, identify_steps
from hilserver.identify.update_rate import compare, identify_update_rate
from hilserver.measured.data import MeasuredLog
from hilserver.measured.machine import machine
from hilserver.measured.reading import read_measured

EXAMPLE = "hilserver identify rotation spin.csv -c config.yaml"

Answer = tuple[list[str], dict[str, Any]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add one subcommand per kind of figure."""
    kinds = parser.add_subparsers(title="what", metavar="WHAT", required=True)
    rotation = _kind(
        kinds, "rotation", _rotation, "K_om, and checks of sign and wheel pairs"
    )
    rotation.add_argument(
        "--zone",
        type=POSITIVE,
        default=3.0,
        metavar="RPM",
        help="steady: within this distance of the set-point [rpm]; default: 3",
    )
    rotation.add_argument(
        "--settle",
        type=POSITIVE,
        default=0.3,
        metavar="S",
        help="for at least this long [s]; default: 0.3",
    )
    step = _kind(
        kinds, "step", _step, "order, time constants and gain by Strejc's method"
    )
    step.add_argument(
        "--input",
        choices=[name.split("_")[0] for name in INPUTS],
        help="default: whichever has steps",
    )
    _kind(
        kinds,
        "update-rate",
        _update_rate,
        "update rate of a controller; compares several logs",
    )
    _kind(
        kinds,
        "dead-zone",
        _dead_zone,
        "duty at which the wheels stop, from a slow ramp",
    )
    noise = _kind(
        kinds, "noise", _noise, "noise of every sensor while the robot is at rest"
    )
    noise.add_argument(
        "--everywhere",
        action="store_true",
        help="use the whole log: its values are errors already",
    )


def run(args: argparse.Namespace) -> int:
    """Identify; print lines, or JSON."""
    lines, values = args.identify(args)
    print(
        json.dumps(values, indent=2, allow_nan=False) if args.json else "\n".join(lines)
    )
    return EXIT_DONE


def _kind(
    kinds: Any, name: str, identify: Callable[[argparse.Namespace], Answer], about: str
) -> argparse.ArgumentParser:
    example = f"example: hilserver identify {name} run.csv"
    parser: argparse.ArgumentParser = kinds.add_parser(
        name, help=about, description=about, epilog=example
    )
    parser.add_argument(
        "logs", nargs="+", type=Path, metavar="LOG", help="logs of one machine"
    )
    add_config(parser)
    add_mapping(parser)
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(identify=identify)
    return parser


def _read(paths: list[Path], mapping: str | None) -> MeasuredLog:
    log = read_measured(paths, mapping)
    warn(*log.notices)
    return log


def _rotation(args: argparse.Namespace) -> Answer:
    log = _read(args.logs, args.mapping)
    robot = machine(log, assemble(config_path(args)).robot)
    gain = identify_rotation(log, robot, zone_rpm=args.zone, settle_s=args.settle)
    checks = [*check_sides(log), check_sign(gain)]
    values = text.as_json("rotation", gain) | {"checks": text.as_list(checks)}
    return text.rotation_lines(gain, checks), values


def _step(args: argparse.Namespace) -> Answer:
    source = next(
        (name for name in INPUTS if args.input and name.startswith(args.input)), None
    )
    found = identify_steps(_read(args.logs, args.mapping), source)
    return text.step_lines(found), text.as_json("step", found)


def _update_rate(args: argparse.Namespace) -> Answer:
    rates = [identify_update_rate(_read([path], args.mapping)) for path in args.logs]
    pairs = compare(rates)
    values = {"logs": text.as_list(rates), "comparisons": text.as_list(pairs)}
    return text.rate_lines(rates, pairs), text.as_json("update-rate", values)


def _dead_zone(args: argparse.Namespace) -> Answer:
    zones = identify_dead_zone(_read(args.logs, args.mapping))
    return text.zone_lines(zones), text.as_json(
        "dead-zone", {"wheels": text.as_list(zones)}
    )


def _noise(args: argparse.Namespace) -> Answer:
    log = _read(args.logs, args.mapping)
    channels = identify_noise(log, everywhere=args.everywhere)
    return text.noise_lines(channels), text.as_json(
        "noise", {"channels": text.as_list(channels)}
    )

"""The command line: one thin file per command.

Each command module has ``EXAMPLE``, ``add_arguments(parser)`` and ``run(args) -> exit code``. Only
the module of the command that was asked for is imported, so that ``--help`` answers at once.
"""

import argparse
import importlib
import sys
from collections.abc import Sequence
from types import ModuleType

from hilserver import __version__
from hilserver.errors import meant
from hilserver.program import harness
from hilserver.program.ending import say_stopped

COMMANDS = {
    "run": "run the daemon",
    "check": "validate a configuration and explain what it means",
    "signals": "print the signal table",
    "teleop": "drive a running daemon with the keys of this terminal",
    "call": "call a method of a running daemon, from the shell",
    "set": "write signals of a running daemon, from the shell",
    "inject": "inject a fault into a running daemon, from the shell",
    "model": "write the robot as URDF or MJCF",
    "fmu": "write the robot as an FMU for other simulators",
    "wiring": "commissioning: check that every wheel drives the right input",
    "certs": "manage certificates, trusted clients and passwords",
    "page": "show the operator page in the browser, as 'run' does",
    "record": "record the signals of a running daemon",
    "simulate": "play a scenario in virtual time and write every signal to a file",
    "experiment": "drive an experiment of the thesis again, with both models and its figures",
    "sweep": "run a controller on thousands of machines: how many pass, what decides it",
    "convert": "convert a log to another format: CSV, MCAP, MF4, ROS 2 bag, Parquet",
    "replay": "feed a log through the plant, faster than real time",
    "compare": "compare two recordings: the first difference, and how it grows",
    "diagnose": "find where the simulation differs from measured data, and why",
    "observe": "estimate where the robot was, from wheels, gyro and navigation",
    "plan": "predict what an experiment can show, and propose a better manoeuvre",
    "identify": "identify K_om, step response, update rate, dead zone or noise",
    "latency-test": "measure the timing of this computer, without the model",
    "install-service": "install the daemon as a systemd service",
    "cache": "show or clear the compiled code that is kept on this computer",
    "scenarios": "make logs of the drives that the thesis says its simulation gets wrong",
    "bench": "measure the figures that the README quotes",
}

STARTING = "stopped while starting; nothing was done"
STOPPED = "stopped before it was finished"
# their log, JSON perhaps, and the exit code say how they ended
SERVICES = (["run"], ["page"])
"""What a signal leaves of any command but `run`, whose own words have the form of its log."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; return its exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    return harness.run(lambda: _run(words))


def _run(words: Sequence[str]) -> int:
    left = STARTING
    try:
        args = _parse(words)
        left = STOPPED
        code: int = args.run(args)
    except (Exception, SystemExit):
        if words[:1] not in SERVICES:
            say_stopped(left)
        raise
    return code


def _parse(words: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="hilserver",
        description="Real-time hardware-in-the-loop simulation of wheeled robots.",
        epilog="example: hilserver run --demo",
    )
    parser.add_argument(
        "--version", action="version", version=f"hilserver {__version__}"
    )
    sub = parser
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    asked = next((word for word in words if not word.startswith("-")), None)
    if asked is not None and asked not in COMMANDS:
        parser.error(
            f"there is no command '{asked}'; {meant(asked, COMMANDS, 'see --help')}"
        )
    for name, text in COMMANDS.items():
        if name != asked:
            commands.add_parser(name, help=text)
            continue
        module = _module(name)
        sub = commands.add_parser(
            name,
            help=text,
            description=module.__doc__,
            epilog=f"example: {module.EXAMPLE}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.add_arguments(sub)
        sub.set_defaults(run=module.run)
    args, left = parser.parse_known_args(words)
    if left:
        word = left[0]
        if (
            word.endswith((".yaml", ".yml"))
            and "config" in args
            and args.config is None
        ):
            sub.error(f"{asked} does not take '{word}'; write '-c {word}'")
        if word.startswith("-"):
            sub.error(f"{asked} does not take '{word}'")
        sub.error(f"unrecognized arguments: {' '.join(left)}")
    return args


def _module(command: str) -> ModuleType:
    return importlib.import_module(f"{__name__}.{command.replace('-', '_')}")

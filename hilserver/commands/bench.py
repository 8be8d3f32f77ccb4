"""Measure the figures that the README quotes, each with its reference in the same run.

What needs peers and rivals of hilserver is not installed with it; in a checkout it is here, too.
"""

import argparse
import importlib
from typing import Any

from hilserver.bench.report import as_json, as_table
from hilserver.commands.checkout import beside
from hilserver.commands.options import out_file, write_text
from hilserver.errors import EXIT_DONE, FailedError

EXAMPLE = "hilserver bench plant --json plant.json"
BENCHES = {
    "plant": "one step of four wheels and pose against the same recurrence in C",
    "jitter": "wake latency under OPC UA load against cyclictest",
    "loop": "set-point to pose and back over TCP, two processes",
}
ELSEWHERE = (
    "a53", "attack", "diagnose", "fmu", "mechatronic", "observer", "opcua", "page", "recalibration",
    "ros2", "s7", "shield", "start", "stop", "sweep", "tune",
)  # fmt: skip
"""Benches of a checkout, in its folder ``benchmarks``."""


class _BenchParser(argparse.ArgumentParser):
    """Imports its bench when that is asked for: all together take seconds."""

    path = ""  # of the module; empty: none

    def load(self) -> None:
        """Add what its bench has to ask for, once."""
        path, self.path = self.path, ""
        if path:
            module = importlib.import_module(path)
            self.set_defaults(measure=module.run)
            if hasattr(module, "add_arguments"):
                module.add_arguments(self)

    def parse_known_args(self, *given: Any, **named: Any) -> Any:
        self.load()
        return super().parse_known_args(*given, **named)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add one sub-command per bench."""
    benches = parser.add_subparsers(
        title="benches", metavar="BENCH", required=True, parser_class=_BenchParser
    )
    modules = {
        name: (f"hilserver.bench.{name}", text) for name, text in BENCHES.items()
    }
    benchmarks = beside("benchmarks")
    others: dict[str, str] = {} if benchmarks is None else benchmarks.BENCHES
    modules |= {name: (f"benchmarks.{name}", text) for name, text in others.items()}
    for name, (path, text) in modules.items():
        bench = benches.add_parser(
            name, help=text, epilog=f"example: hilserver bench {name}"
        )
        bench.path = path
        bench.add_argument(
            "--json",
            type=out_file,
            metavar="FILE",
            help="write the figures and raw data to FILE",
        )
    for name in ELSEWHERE if not others else ():
        absent = benches.add_parser(
            name,
            help="only in a source checkout of hilserver",
            prefix_chars="\0",
            add_help=False,
        )
        absent.add_argument("words", nargs="*")
        absent.set_defaults(measure=_absent, bench=name, json=None)


def _absent(args: argparse.Namespace) -> Any:
    raise FailedError(
        f"'bench {args.bench}' compares with other programs and is not installed with hilserver;"
        f" run 'python -m benchmarks {args.bench}' in a checkout of its source"
    )


def run(args: argparse.Namespace) -> int:
    """Run one bench, print its table, and write the JSON file if requested."""
    results = args.measure(args)
    print(as_table(results))
    if args.json is not None:
        write_text(args.json, as_json(results))
    return EXIT_DONE

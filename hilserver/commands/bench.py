"""Measure the figures that the README quotes, each with its reference in the same run."""

import argparse
import importlib

from hilserver.bench.report import as_table, write_json
from hilserver.commands.options import out_file
from hilserver.errors import EXIT_DONE

EXAMPLE = "hilserver bench plant --json plant.json"
BENCHES = {
    "plant": "one step of four wheels and pose against the same recurrence in C",
    "jitter": "wake latency under OPC UA load against cyclictest",
    "opcua": "what being watched costs: CPU per delivered value, next to stock asyncua",
    "attack": "malformed packets and floods against the OPC UA server, next to a healthy client",
    "page": "what the operator page costs: server, plant's deadlines, browser",
    "loop": "set-point to pose and back over TCP, two processes",
    "shield": "serial line of the shield: rate, lateness next to cyclictest, cost",
    "ros2": "ROS 2 over DDS: rate, latency, losses, cost, next to two other DDS programs",
    "mechatronic": "a step of the body beside plain mj_step; the plant's wake latency with it",
    "diagnose": "hidden causes in hundreds of logs: found, missed, misnamed",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add one sub-command per bench."""
    benches = parser.add_subparsers(title="benches", metavar="BENCH", required=True)
    for name, text in BENCHES.items():
        bench = benches.add_parser(name, help=text, epilog=f"example: hilserver bench {name}")
        bench.add_argument(
            "--json", type=out_file, metavar="FILE", help="write figures and raw data"
        )
        bench.set_defaults(bench=name)
        module = importlib.import_module(f"hilserver.bench.{name}")
        if hasattr(module, "add_arguments"):
            module.add_arguments(bench)


def run(args: argparse.Namespace) -> int:
    """Run one bench, print its table, write the JSON file if asked to."""
    module = importlib.import_module(f"hilserver.bench.{args.bench}")
    results = module.run(args)
    print(as_table(results))
    if args.json is not None:
        write_json(args.json, results)
    return EXIT_DONE

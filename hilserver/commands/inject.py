"""Inject a fault into a running daemon; ``call ClearFaults`` ends all."""

import argparse
import json

from hilserver.commands.remote import add_connection, ask, from_json
from hilserver.errors import UsageError

EXAMPLE = """hilserver inject '{"fault": "bias", "signal": "battery.voltage_v", "offset": -2}'"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    add_connection(parser)
    parser.add_argument(
        "fault", metavar="JSON", help="fault; see docs/reference/faults.md"
    )


def run(args: argparse.Namespace) -> int:
    """Inject; return 0 once the daemon has accepted the fault."""
    fault = from_json(args.fault)
    if not isinstance(fault, dict):
        raise UsageError('a fault is a JSON object such as \'{"fault": "bias", ...}\'')
    return ask(args, lambda hand: hand.call("InjectFault", [json.dumps(fault)]))

"""Call a method of a running daemon; its arguments are JSON, or plain words."""

import argparse

from hilserver.commands.remote import add_connection, ask, from_json
from hilserver.errors import UsageError, meant
from hilserver.io.opcua_server.method_table import METHODS

EXAMPLE = "hilserver call SetPose 1.0 0.5 0"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    add_connection(parser)
    parser.add_argument("method", help=", ".join(method.name for method in METHODS))
    parser.add_argument("arguments", nargs="*", metavar="JSON", help="its arguments")


def run(args: argparse.Namespace) -> int:
    """Call; return 0 once the daemon has done it."""
    method = next((method for method in METHODS if method.name == args.method), None)
    if method is None:
        names = [method.name for method in METHODS]
        hint = meant(args.method, names, f"the methods are {', '.join(names)}")
        raise UsageError(f"there is no method '{args.method}'; {hint}")
    wanted = [argument.name for argument in method.arguments]
    if len(args.arguments) != len(wanted):
        raise UsageError(
            f"{method.name} takes {len(wanted)} arguments: {', '.join(wanted)}"
        )
    arguments = [from_json(text) for text in args.arguments]
    return ask(args, lambda hand: hand.call(method.name, arguments))

"""Write signals, or parameters.*, of a running daemon, all in one tick.

Set-points need control, as of any client: write ``control.source`` first. They act until another
source takes control; for driving there are ``teleop`` and scenarios, whose commands are renewed.
"""

import argparse
import math
from typing import TYPE_CHECKING, Any

from hilserver.commands.remote import PARAMETERS, add_connection, ask, from_json
from hilserver.errors import UsageError, no_signal
from hilserver.signals import Ranges, robot_table

if TYPE_CHECKING:
    from hilserver.parameters import Parameter

EXAMPLE = "hilserver set control.source=opcua"
SOURCE = "control.source"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    add_connection(parser)
    parser.add_argument(
        "values",
        nargs="+",
        metavar="SIGNAL=JSON",
        help="or one JSON object of signals and values",
    )


def run(args: argparse.Namespace) -> int:
    """Write; return 0 once the daemon has accepted all values."""
    values: dict[str, Any] = {}
    for text in args.values:
        if text.startswith("{"):
            values |= from_json(text)
            continue
        named, equals, value = text.partition("=")
        if not equals:
            raise UsageError(
                f"'{text}': write SIGNAL=VALUE, or a JSON object in single quotes"
            )
        given = from_json(value)
        is_null = given is None and named.startswith(PARAMETERS)
        values[named] = math.nan if is_null else given
    names = [SOURCE, *(signal.name for signal in robot_table(Ranges(1.0, 1.0, 1.0)))]
    parameters = [name for name in values if name.startswith(PARAMETERS)]
    if parameters:
        from hilserver.parameters import table_of  # noqa: PLC0415 -- needs the compiler

        table = {
            f"{PARAMETERS}{name}": parameter for name, parameter in table_of().items()
        }
        names += table
        values |= {n: _number(table[n], values[n]) for n in parameters if n in table}
    for name in values:
        if name not in names:
            raise UsageError(no_signal(name, names))
    return ask(args, lambda hand: hand.write(values), parameters)


def _number(parameter: "Parameter", value: Any) -> Any:
    """Return the number that a name stands for; another value as it is.

    Which name of the geometry stands for null only the daemon knows.
    """
    known = {name: number for name, number in parameter.names if not math.isnan(number)}
    word = str(value).lower() if isinstance(value, bool) else value
    return known.get(word, value) if isinstance(word, str) else value

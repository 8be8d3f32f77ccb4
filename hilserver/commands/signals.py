"""Print the signal table: every signal once, as Markdown, CSV or an OPC UA NodeSet2 file.

The table is that of the configuration, own blocks included; without one, that of the defaults. As
SCL it prints the data blocks of the configuration, for the project of an S7 controller; as C and C#
the process image in shared memory, for programs on the daemon's computer.
"""

import argparse
import csv
import io
from collections.abc import Callable

from hilserver.commands.options import add_config, config_path, out_file, write_text
from hilserver.daemon.assembly import Assembly, assemble
from hilserver.errors import EXIT_DONE, ConfigError
from hilserver.io.opcua_server.nodeset import to_nodeset
from hilserver.io.opcua_server.units import find_unit
from hilserver.io.s7.scl import to_scl
from hilserver.io.shared_memory.headers import to_c, to_csharp
from hilserver.parameters import PLANT
from hilserver.signals import Signal, SignalTable

EXAMPLE = "hilserver signals --format nodeset2 -o hilserver.nodeset2.xml"

COLUMNS = ("signal", "type", "unit", "unece", "direction", "low", "high", "description")

HEAD = """# Signals

Made by `hilserver signals --format markdown`; a test keeps it up to date. Ranges follow from the
configuration, here the default one. In OPC UA every signal is the variable
`nsu=urn:hilserver:robot;s=<signal>`, in a log it is the column of that name; `in` is seen from the
plant.

"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``-c``, ``--format`` and ``-o``."""
    add_config(parser)
    parser.add_argument(
        "--format", choices=tuple(FORMATS), default="markdown", help="default: markdown"
    )
    parser.add_argument(
        "-o",
        "--out",
        type=out_file,
        metavar="FILE",
        help="write to a file instead of the terminal",
    )


def run(args: argparse.Namespace) -> int:
    """Print or write the table."""
    text = FORMATS[args.format](assemble(config_path(args)))
    if not text:
        raise ConfigError(
            "the configuration has no data block: add s7.server, or a peer at s7://; see"
            " docs/how-to/s7.md"
        )
    if args.out is None:
        print(text, end="")
        return EXIT_DONE
    write_text(args.out, text)
    return EXIT_DONE


def row(signal: Signal) -> tuple[str, ...]:
    """Return a signal as one row under `COLUMNS`."""
    length = f"[{len(signal.slots)}]" if signal.is_array else ""
    kind = signal.type.value + length
    unit_code = find_unit(signal.unit).code
    return (
        signal.name,
        kind,
        signal.unit,
        unit_code,
        signal.direction.value,
        f"{signal.low:.6g}",
        f"{signal.high:.6g}",
        signal.description,
    )


def as_markdown(table: SignalTable) -> str:
    """Return the reference page."""
    lines = [
        f"| {' | '.join(COLUMNS)} |",
        f"|{'---|' * len(COLUMNS)}",
        *(f"| `{name}` | {' | '.join(rest)} |" for name, *rest in map(row, table)),
    ]
    return HEAD + "\n".join(lines) + "\n"


def as_csv(table: SignalTable) -> str:
    """Return the table as CSV with a header row."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(row(signal) for signal in table)
    return text.getvalue()


FORMATS: dict[str, Callable[[Assembly], str]] = {
    "markdown": lambda assembly: as_markdown(assembly.table),
    "csv": lambda assembly: as_csv(assembly.table),
    "nodeset2": lambda assembly: to_nodeset(assembly.table, PLANT.values()),
    "scl": lambda assembly: to_scl(assembly.config),
    "c": lambda assembly: to_c(assembly.table, assembly.config.image.name),
    "csharp": lambda assembly: to_csharp(assembly.table, assembly.config.image.name),
}

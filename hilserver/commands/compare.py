"""Compare two recordings: the first tick that differs, how it grows, and what may be the cause.

For a replay beside its recording, the same scenario before and after a change, a simulated log
beside a measured one. MCAP recordings are read a piece at a time, whatever their size.
"""

import argparse
import math
from pathlib import Path

from hilserver.comparison import Curves, as_text, compare
from hilserver.errors import EXIT_DIFFERENT, EXIT_DONE, FailedError, LogError
from hilserver.logs.reading import read_pieces
from hilserver.program.whole_file import write_whole

EXAMPLE = "hilserver compare before.mcap after.mcap --tolerance 'pose.*=1e-6'"
FILE = "comparison.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    parser.add_argument("a", type=Path, metavar="A", help="recording, or any log")
    parser.add_argument("b", type=Path, metavar="B", help="the one to compare it with")
    parser.add_argument(
        "--tolerance",
        action="append",
        default=[],
        type=_tolerance,
        metavar="SIGNAL=X",
        help="difference that counts as none, in the signal's unit; * fits several signals;"
        " may be repeated; default: every bit counts",
    )
    parser.add_argument(
        "-o",
        "--out",
        type=Path,
        metavar="DIR",
        help="write comparison.json there, too: the curves of both for a plot",
    )


def _tolerance(text: str) -> tuple[str, float]:
    pattern, mark, number = text.rpartition("=")
    try:
        size = float(number)
    except ValueError:
        size = math.nan
    if not mark or not pattern or not size >= 0.0:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not SIGNAL=X with a number, for example pose.x_m=1e-6"
        )
    return pattern, size


def run(args: argparse.Namespace) -> int:
    """Compare; 0 if equal, 4 if not, 2 if they cannot be compared."""
    if args.a.exists() and args.b.exists() and args.a.samefile(args.b):
        raise LogError(f"{args.b}: is the same file; give another recording")
    curves = None
    if args.out is not None:
        if args.out.exists() and not args.out.is_dir():
            raise FailedError(f"{args.out}: is a file; name a folder for {FILE}")
        args.out.mkdir(parents=True, exist_ok=True)  # before the work, not after it
        curves = Curves()
    found = compare(
        read_pieces(args.a),
        read_pieces(args.b),
        args.tolerance,
        see=curves.add if curves is not None else None,
    )
    print(as_text(found))
    if curves is not None:
        write_whole(args.out / FILE, curves.as_json(found))
    return EXIT_DONE if found.is_equal else EXIT_DIFFERENT

"""Options that several commands share."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hilserver.errors import FailedError, UsageError, reason
from hilserver.program.shared_memory import MADE_UP, made_up_in_use
from hilserver.program.whole_file import writing

DEFAULT_CONFIG = Path("config.yaml")


def add_config(parser: argparse.ArgumentParser) -> None:
    """Add ``-c/--config``."""
    parser.add_argument(
        "-c",
        "--config",
        type=Path,
        metavar="FILE",
        help="configuration; default: config.yaml in this folder, if it exists",
    )


def add_storage(parser: argparse.ArgumentParser) -> None:
    """Add ``--storage``."""
    parser.add_argument(
        "--storage",
        choices=("mcap", "sqlite3"),
        default="mcap",
        help="storage of a bag; mcap loses less if the recorder is killed; default: mcap",
    )


def add_patch(parser: argparse.ArgumentParser) -> None:
    """Add ``--patch`` and ``--group``."""
    parser.add_argument(
        "--patch",
        type=Path,
        metavar="FILE",
        help="extend the plant with a model_patch.yaml written by 'hilserver diagnose'",
    )
    parser.add_argument(
        "--group",
        metavar="NAME",
        help="group to use, if the patch differs by floor or load",
    )


def add_mapping(parser: argparse.ArgumentParser) -> None:
    """Add ``--mapping``."""
    parser.add_argument(
        "--mapping",
        metavar="FILE",
        help="mapping file for foreign logs, or a built-in one by name",
    )


def add_image(parser: argparse.ArgumentParser) -> None:
    """Add ``--image``."""
    parser.add_argument(
        "--image",
        metavar="NAME",
        help="process image of the daemon; default: that of the -c file",
    )


def known_image(configured: str) -> str:
    """Return a configured `image.name`; UsageError where each daemon makes up a name of its own."""
    if configured != MADE_UP:
        return configured
    running = ", ".join(made_up_in_use()) or "none"
    raise UsageError(
        f"image.name is 'auto': name the process image with --image (in use now: {running})"
    )


def add_out(parser: argparse.ArgumentParser, metavar: str, what: str) -> None:
    """Add ``-o/--out``, which is needed."""
    parser.add_argument(
        "-o", "--out", type=Path, required=True, metavar=metavar, help=what
    )


def config_path(args: argparse.Namespace) -> Path | None:
    """Return the configuration file: the requested one, else the one in this folder, else None."""
    if args.config is not None:
        return Path(args.config)
    return DEFAULT_CONFIG if DEFAULT_CONFIG.exists() else None


def out_file(text: str) -> Path:
    """Return the file to write to, tried now rather than after minutes of measuring.

    FailedError if it cannot be written.
    """
    path = Path(text)
    is_new = not path.exists()
    try:
        with path.open("ab"):
            pass
        if is_new:
            path.unlink()
    except OSError as error:
        raise FailedError(f"cannot write {path}: {reason(error)}") from None
    return path


def write_text(path: Path, text: str) -> None:
    """Write a file that was asked for whole; FailedError names one that the disk does not take."""
    with writing(path) as partial:
        partial.write_text(text, encoding="utf-8")


def number(
    low: float, high: float, what: str, kind: type[float] | type[int] = float
) -> Callable[[str], Any]:
    """Return an argument type: a number within `low` .. `high`; `what` says what it should be."""

    def parse(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = None
        if value is None or not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text} is not a {what}")
        return value

    return parse


def comma_names(text: str) -> tuple[str, ...]:
    """Return the names between commas, an argument type; an empty one is refused."""
    names = tuple(name.strip() for name in text.split(","))
    if not all(names):
        raise argparse.ArgumentTypeError(
            f"{text!r} has a comma without a name; write names with commas, but no spaces, between"
            " them"
        )
    return names


POSITIVE = number(sys.float_info.min, 1e9, "number above 0")
SEED = number(0, 2**32 - 1, "seed (0 .. 4294967295)", int)
PROCESSES = number(1, 1024, "number of processes (1 .. 1024)", int)


def warn(*notices: str | None) -> None:
    """Print sentences that do not stop the command."""
    for notice in notices:
        if notice is not None:
            print(f"hilserver: {notice}", file=sys.stderr)

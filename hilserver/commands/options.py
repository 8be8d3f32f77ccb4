"""Options that several commands share."""

import argparse
from pathlib import Path

from hilserver.errors import FailedError

DEFAULT_CONFIG = Path("config.yaml")


def add_config(parser: argparse.ArgumentParser) -> None:
    """Add ``-c/--config``."""
    parser.add_argument(
        "-c",
        "--config",
        type=Path,
        metavar="FILE",
        help="configuration; default: config.yaml in this folder, if there is one",
    )


def add_storage(parser: argparse.ArgumentParser) -> None:
    """Add ``--storage``."""
    parser.add_argument(
        "--storage",
        choices=("mcap", "sqlite3"),
        default="mcap",
        help="of a bag; a killed recorder loses less of mcap; default: mcap",
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
        "--group", metavar="NAME", help="with --patch: its group, where it differs by floor or load"
    )


def config_path(args: argparse.Namespace) -> Path | None:
    """Return the configuration file that was asked for, or the one in this folder, or None."""
    if args.config is not None:
        return Path(args.config)
    return DEFAULT_CONFIG if DEFAULT_CONFIG.exists() else None


def out_file(text: str) -> Path:
    """Return the file to write to, tried now and not after minutes of measuring.

    Raises
    ------
    FailedError
        If it cannot be written.
    """
    path = Path(text)
    is_new = not path.exists()
    try:
        with path.open("ab"):
            pass
        if is_new:
            path.unlink()
    except OSError as error:
        reason = (error.strerror or "refused").lower()
        raise FailedError(f"cannot write {path}: {reason}") from None
    return path


def number_within(low: float, high: float, text: str, what: str) -> float:
    """Return `text` as a number within `low` .. `high`.

    Raises
    ------
    argparse.ArgumentTypeError
        If it is none; `what` says what it should be.
    """
    try:
        value = float(text)
    except ValueError:
        value = low - 1.0
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"{text} is not a {what}")
    return value

"""The option ``--patch``: a configuration with the terms of a diagnosis laid over it."""

import argparse
import sys
from pathlib import Path

from hilserver.commands.options import config_path
from hilserver.daemon.assembly import Assembly, assemble


def add_patch(parser: argparse.ArgumentParser) -> None:
    """Add ``--patch``."""
    parser.add_argument(
        "--patch",
        type=Path,
        metavar="FILE",
        help="extend the plant with a model_patch.yaml written by 'hilserver diagnose'",
    )


def assembled(args: argparse.Namespace) -> Assembly:
    """Assemble the configuration that was asked for, with the patch.

    A patch that was fitted to another configuration is warned about.

    Raises
    ------
    ConfigError
        One line per complaint.
    """
    assembly = assemble(config_path(args), args.patch)
    if assembly.patch is not None:
        warn(assembly.patch.notice(assembly.config.sha256))
    return assembly


def warn(notice: str | None) -> None:
    """Print a sentence that does not stop the command."""
    if notice is not None:
        print(f"hilserver: {notice}", file=sys.stderr)

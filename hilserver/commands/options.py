"""Options that several commands share."""

import argparse
from pathlib import Path

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


def config_path(args: argparse.Namespace) -> Path | None:
    """Return the configuration file that was asked for, or the one in this folder, or None."""
    if args.config is not None:
        return Path(args.config)
    return DEFAULT_CONFIG if DEFAULT_CONFIG.exists() else None

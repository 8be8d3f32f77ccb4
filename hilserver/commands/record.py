"""Record the signals of a running daemon to MCAP or CSV, every tick, in a process of its own.

A killed recorder loses less than the last second. The file carries version, configuration, kernels,
seed, audit and a state, so that `hilserver replay` reproduces it bit for bit.
"""

import argparse
import contextlib
import os
import sys

from hilserver.commands.options import (
    POSITIVE,
    add_config,
    add_image,
    add_out,
    add_storage,
    config_path,
    known_image,
    number,
    warn,
)
from hilserver.config.root import load_config
from hilserver.errors import EXIT_DONE, UsageError
from hilserver.io.recorder import Recorder, Settings
from hilserver.program.ending import on_end

RECORDER_NICENESS = -5
"""The ring holds two seconds: on a busy computer its reader must not wait for longer."""
EXAMPLE = "hilserver record -o run.mcap --duration 60"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    add_out(
        parser,
        "OUT",
        "file to write, .mcap (Foxglove, PlotJuggler) or .csv; folder of a bag",
    )
    parser.add_argument(
        "--format",
        choices=("file", "bag"),
        default="file",
        help="bag: a ROS 2 bag, every signal as float64 beside EduArt's topics",
    )
    add_storage(parser)
    add_config(parser)
    add_image(parser)
    parser.add_argument(
        "--signals",
        action="append",
        metavar="PATTERN",
        help="signals to record, with * and ?; may be repeated; default: all",
    )
    parser.add_argument(
        "--sparse",
        action="store_true",
        help="skip ticks in which no recorded signal changes; such a log cannot be replayed",
    )
    for name, kind, default, unit, text in _NUMBERS:
        parser.add_argument(name, type=kind, default=default, metavar=unit, help=text)


_MEGABYTES = number(1, 1e9, "size of at least 1 MB (one state takes 0.1 MB)")
_FILES = number(1, 999_999, "whole number of at least 1", int)
_NUMBERS = (
    ("--duration", POSITIVE, None, "S", "stop after this many seconds"),
    (
        "--rotate-mb",
        _MEGABYTES,
        None,
        "N",
        "start a new file OUT_0001 ... after N megabytes",
    ),
    ("--rotate-s", POSITIVE, None, "S", "start a new file after S seconds"),
    ("--keep", _FILES, None, "N", "keep the newest N files of a rotation"),
    (
        "--max-mb",
        POSITIVE,
        50_000.0,
        "N",
        "stop at this total size in MB; default: 50000",
    ),
    (
        "--keep-free-mb",
        float,
        500.0,
        "N",
        "stop before fewer MB are free on the disk; default: 500",
    ),
    ("--buffer-mb", POSITIVE, 64.0, "N", "buffer for a slow disk in MB; default: 64"),
)
"""Option, type, default, unit, help."""


def run(args: argparse.Namespace) -> int:
    """Record until Ctrl-C, SIGTERM, ``--duration`` or the end of the daemon."""
    rotates = args.rotate_mb is not None or args.rotate_s is not None
    if args.keep is not None and not rotates:
        raise UsageError(
            "--keep counts the files of a rotation; give --rotate-mb as well"
        )
    if args.format == "bag" and rotates:
        raise UsageError(
            "a bag is one folder; leave out --rotate-mb, or record to .mcap"
        )
    image = args.image
    if image is None:
        image = known_image(load_config(config_path(args)).image.name)
    settings = Settings(
        path=args.out,
        signals=args.signals or ("*",),
        rotate_bytes=None if args.rotate_mb is None else round(args.rotate_mb * 1e6),
        keep=args.keep,
        rotate_s=args.rotate_s,
        sparse=args.sparse,
        max_bytes=args.max_mb * 1e6,
        keep_free_bytes=args.keep_free_mb * 1e6,
        buffer_bytes=round(args.buffer_mb * 1e6),
        bag=args.storage if args.format == "bag" else None,
    )
    recorder = Recorder(
        image,
        settings,
    )
    on_end(recorder.stop.set)
    with contextlib.suppress(
        OSError
    ):  # without the right to, the ring's length must do
        os.nice(RECORDER_NICENESS)
    print(f"recording to {recorder.path}; stop it with Ctrl-C", flush=True)
    if recorder.lacks_inputs or args.sparse:
        warn("without all inputs this recording cannot be replayed")
    print(recorder.run(args.duration), file=sys.stderr, flush=True)
    return EXIT_DONE

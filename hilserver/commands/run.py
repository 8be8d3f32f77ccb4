"""Run the daemon until Ctrl-C, SIGTERM, ``--duration`` or a safety limit."""

import argparse
import contextlib
import gc
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import yaml

from hilserver.cache import reported_by
from hilserver.commands.announcing import Announcer
from hilserver.commands.options import (
    add_config,
    add_patch,
    config_path,
    number,
    write_text,
)
from hilserver.errors import EXIT_DONE, FailedError
from hilserver.program.ending import ENDING, hang_ups_wait
from hilserver.program.guard import guarded
from hilserver.program.shared_memory import DEFAULT_IMAGE, check_free
from hilserver.program.writer import Writer
from hilserver.small_file import read_small

EXAMPLE = "hilserver run --demo"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    add_config(parser)
    add_patch(parser)
    parser.add_argument(
        "--duration",
        type=number(1e-3, 1e9, "duration in seconds"),
        metavar="S",
        help="stop after this many seconds",
    )
    parser.add_argument(
        "--demo",
        action="store_true",
        help="also start an embedded controller that drives a figure of eight",
    )
    parser.add_argument(
        "--twin",
        action="store_true",
        help="also start a 'real robot' that changes after a minute, for the model to notice",
    )
    parser.add_argument(
        "--scenario",
        type=Path,
        metavar="FILE",
        help="play a timed scenario of values and faults from the first tick on",
    )
    parser.add_argument(
        "--scenario-schema",
        type=Path,
        metavar="FILE",
        help="write the JSON Schema of scenarios for editors and exit",
    )
    parser.add_argument(
        "--record",
        type=Path,
        metavar="OUT",
        help="record from the first tick on, into a .mcap or .csv file",
    )


def run(args: argparse.Namespace) -> int:
    """Run; return 0 after a clean end, 3 when policy ``fail`` ended it.

    Slow imports (seconds) and compiling (minutes) come after the first line. The garbage collector
    is off until the daemon runs: almost everything made so far stays, and scanning it repeatedly
    takes a third of the start.
    """
    if args.scenario_schema is not None:
        from hilserver.config.section import schema_text  # noqa: PLC0415
        from hilserver.faults.scenario import Scenario  # noqa: PLC0415

        write_text(args.scenario_schema, schema_text(Scenario))
        return EXIT_DONE
    image, line_format = _peek(config_path(args))
    # At a terminal a hang-up is the end; elsewhere it asks for a reload.
    is_terminal = sys.stderr.isatty()
    ending = (*ENDING, signal.SIGHUP) if is_terminal else ENDING
    waiting = contextlib.nullcontext() if is_terminal else hang_ups_wait()
    with _collector_off(), waiting, guarded(ending) as guard:
        writer = Writer(sys.stderr)
        announcer = Announcer(writer, line_format)
        guard.say = announcer.last_words
        announcer.starting()
        try:
            # A mistake in the file is worth more than that the image is taken.
            path = config_path(args)
            try:
                check_free(image)
            except FailedError:
                from hilserver.config.root import load_config  # noqa: PLC0415

                load_config(path)
                raise
            from hilserver.commands import compiled_start  # noqa: PLC0415
            from hilserver.program import compiling  # noqa: PLC0415

            children = compiling.in_children(
                lambda: compiled_start.commands(args), announcer.compiling
            )
            telling = compiling.telling(lambda name: announcer.compiling([name]))
            with reported_by(announcer.warn), children, telling, announcer.patient():
                from hilserver.commands.running import serve  # noqa: PLC0415

                code = serve(args, guard, announcer)
            if guard.is_asked:  # freeing what the system frees anyway takes a second
                writer.drain()
                os._exit(code)
            return code
        finally:
            writer.drain()


@contextlib.contextmanager
def _collector_off() -> Iterator[None]:
    """Turn the garbage collector off, until something turns it on or this ends."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def _peek(path: Path | None) -> tuple[str, str]:
    """Return ``image.name`` and ``logging.format`` of a file that is not checked yet."""
    found = {"image": {"name": DEFAULT_IMAGE}, "logging": {"format": "auto"}}
    with contextlib.suppress(Exception):  # its later check explains what is wrong
        if path is None:
            content = {}
        else:
            content = yaml.safe_load(read_small(path).decode("utf-8"))
        for name, section in found.items():
            given = content.get(name) if isinstance(content, dict) else None
            found[name] = section | (given if isinstance(given, dict) else {})
    return str(found["image"]["name"]), str(found["logging"]["format"])

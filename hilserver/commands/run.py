"""Run the daemon until Ctrl-C, SIGTERM, ``--duration`` or a safety limit."""

import argparse
import asyncio
import contextlib
import dataclasses
import json
import socket
import sys
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import structlog

from hilserver.commands.announcing import Announcer
from hilserver.commands.credentials import check_credentials
from hilserver.commands.demo import demo_assembly, running_controller
from hilserver.commands.options import add_config, number_within
from hilserver.commands.page_setup import page_setup
from hilserver.commands.patching import add_patch, assembled
from hilserver.config.page import PageConfig
from hilserver.daemon.assembly import Assembly
from hilserver.daemon.daemon import Daemon
from hilserver.daemon.reload import Reloader
from hilserver.errors import EXIT_DONE, FailedError
from hilserver.faults.scenario import Play, json_schema, load_scenario
from hilserver.io.page.launch import running_page
from hilserver.io.page.listening import listen, url_of
from hilserver.logs.writing import check_suffix
from hilserver.monitoring.logging_setup import (
    RepeatLimiter,
    is_readable,
    report_repeats,
    setup_logging,
)
from hilserver.monitoring.watchdog import Watchdog
from hilserver.program import event_loop
from hilserver.program.footer import Footer

EXAMPLE = "hilserver run --demo"

_log = structlog.get_logger(__name__)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    add_config(parser)
    add_patch(parser)
    parser.add_argument(
        "--duration", type=_positive, metavar="S", help="stop after this many seconds"
    )
    parser.add_argument(
        "--demo",
        action="store_true",
        help="also start an embedded controller that drives a figure of eight",
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
        help="write the JSON Schema of scenarios for editors and stop",
    )
    parser.add_argument(
        "--record",
        type=Path,
        metavar="OUT",
        help="record from the first tick on, into a .mcap or .csv file",
    )


def _positive(text: str) -> float:
    return number_within(1e-3, 1e9, text, "duration in seconds")


def run(args: argparse.Namespace) -> int:
    """Run; return 0 after a clean end, 3 when policy ``fail`` ended it."""
    if args.scenario_schema is not None:
        schema = json.dumps(json_schema(), indent=1)
        args.scenario_schema.write_text(schema + "\n", encoding="utf-8")
        return EXIT_DONE
    play = None if args.scenario is None else Play(load_scenario(args.scenario), args.scenario)
    assembly = _recorded(assembled(args), args.record)
    logging = assembly.config.logging
    main = _demo if args.demo else _run
    with Footer(sys.stderr) if sys.stderr.isatty() else contextlib.nullcontext() as footer:
        limiter = setup_logging(logging.level, logging.format, logging.repeat_window_s, footer)
        check_credentials(assembly)
        announcer = Announcer(readable=is_readable(logging.format, sys.stderr), footer=footer)
        return event_loop.run(main(assembly, limiter, args.duration, play, announcer))


def _recorded(assembly: Assembly, path: Path | None) -> Assembly:
    if path is None:
        return assembly
    check_suffix(path)
    recording = assembly.config.recording.model_copy(update={"file": str(path.absolute())})
    config = assembly.config.model_copy(update={"recording": recording})
    return dataclasses.replace(assembly, config=config)


async def _demo(
    assembly: Assembly,
    limiter: RepeatLimiter,
    duration_s: float | None,
    play: Play | None,
    announcer: Announcer,
) -> int:
    async with running_controller(assembly.robot) as endpoint:
        return await _run(demo_assembly(assembly, endpoint), limiter, duration_s, play, announcer)


async def _run(
    assembly: Assembly,
    limiter: RepeatLimiter,
    duration_s: float | None,
    play: Play | None,
    announcer: Announcer,
) -> int:
    virtual = assembly.config.scheduler.backend == "virtual"
    waits = virtual and duration_s is not None  # its first tick is that of the duration
    starting = Daemon(assembly, limiter, play=play, paused=waits)  # compiles: a signal ends that
    asked = event_loop.end_event()
    if asked.is_set():
        return EXIT_DONE
    with _listening(assembly.config.page, announcer) as listener:
        async with starting as daemon:
            watchdog = _make_watchdog(daemon)
            announcer.running(daemon)
            page, status = _page(daemon, listener), announcer.showing_status(daemon)
            async with watchdog.watching(), _reload_on_hangup(daemon, watchdog), page, status:
                code = await daemon.wait(duration_s, asked)
    report_repeats(daemon.limiter or limiter, at_end=True)
    return code


@contextlib.contextmanager
def _listening(page: PageConfig, announcer: Announcer) -> Iterator[socket.socket | None]:
    """Listen for the page and say where; a page that cannot is no reason not to run."""
    if not page.enabled:
        yield None
        return
    try:
        listener = listen(page.host, page.port)
    except FailedError as error:
        _log.warning("running without the page", reason=str(error))
        yield None
        return
    with listener:
        announcer.page(url_of(listener, page.host, is_encrypted=page.tls is not None))
        yield listener


def _page(
    daemon: Daemon, listener: socket.socket | None
) -> contextlib.AbstractAsyncContextManager[None]:
    if listener is None:
        return contextlib.nullcontext()
    server = daemon.server
    endpoint, secret = ("", "") if server is None else (server.url, server.page_secret)
    return running_page(page_setup(daemon.assembly, daemon.image.name, endpoint, secret), listener)


def _make_watchdog(daemon: Daemon) -> Watchdog:
    control = daemon.control
    return Watchdog(
        heartbeat_ns=lambda: daemon.scheduler.heartbeat_ns,
        ready=lambda: daemon.supervision.first_ticks_met,
        status=lambda: f"{control.state.word}: {control.reason}",
    )


@contextlib.asynccontextmanager
async def _reload_on_hangup(daemon: Daemon, watchdog: Watchdog) -> AsyncIterator[None]:
    """Re-read the configuration at SIGHUP; on a terminal, a hang-up ends the daemon as usual."""
    if sys.stderr.isatty():
        yield
        return
    reloader = Reloader(daemon)

    async def answer(asked: asyncio.Event) -> None:
        while True:
            await asked.wait()
            asked.clear()
            with watchdog.reloading():
                await reloader.reload()

    with event_loop.hang_ups() as asked:
        task = asyncio.create_task(answer(asked), name="reload")
        try:
            yield
        finally:
            task.cancel()

"""What `hilserver run` runs: the daemon, its page and its controller, until something ends it."""

import argparse
import asyncio
import contextlib
import dataclasses
import gc
import socket
import sys
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import structlog

from hilserver.commands.announcing import Announcer
from hilserver.commands.demo import (
    demo_assembly,
    running_controller,
    running_robot,
    twin_assembly,
)
from hilserver.commands.page_setup import page_setup
from hilserver.commands.patching import assembled
from hilserver.commands.validation import validate
from hilserver.config.page import PageConfig
from hilserver.core.events import Event, EventKind
from hilserver.daemon.assembly import Assembly
from hilserver.daemon.connections import LINKS
from hilserver.daemon.daemon import Daemon
from hilserver.daemon.reload import Reloader
from hilserver.errors import EXIT_DONE, FailedError
from hilserver.faults.scenario import Play, load_scenario
from hilserver.io.page.launch import PageBeside
from hilserver.io.page.listening import listen, moved, url_of
from hilserver.monitoring.logging_setup import report_repeats, setup_logging
from hilserver.monitoring.watchdog import Watchdog
from hilserver.program import event_loop
from hilserver.program.guard import Guard
from hilserver.recalibration import link as recalibration

_log = structlog.get_logger(__name__)


def serve(args: argparse.Namespace, guard: Guard, announcer: Announcer) -> int:
    """Run the daemon of a command line; return the exit code."""
    if args.scenario is None:
        play = None
    else:
        play = Play(load_scenario(args.scenario), args.scenario)
    assembly = _recorded(assembled(args), args.record)
    run = Run(assembly, args.duration, play, announcer, guard)
    validate(assembly)  # what it says of certificates has the form of the log
    announcer.waits_for = "its parts and the first ticks"
    with announcer:
        try:
            task = run.twin() if args.twin else run.demo() if args.demo else run.robot()
            code = event_loop.run(task)
        except asyncio.CancelledError:
            code = EXIT_DONE
    _log.info("hilserver has ended", exit_code=code)
    return code


def _recorded(assembly: Assembly, path: Path | None) -> Assembly:
    if path is None:
        return assembly
    from hilserver.logs.writing import check_suffix  # noqa: PLC0415 -- only where it is used

    check_suffix(path)
    config = assembly.config.changed(recording={"file": str(path.absolute())})
    return dataclasses.replace(assembly, config=config)


# rooms above the daemon, which may not import them
LINKS_AND_MORE = (*LINKS, recalibration.parts)


class Run:
    """One run of one robot, for a time or until it is asked to end."""

    def __init__(
        self,
        assembly: Assembly,
        duration_s: float | None,
        play: Play | None,
        announcer: Announcer,
        guard: Guard,
    ) -> None:
        self._assembly = assembly
        self._announcer = announcer
        self._guard = guard
        self._duration_s = duration_s
        self._play = play
        self._page_moved = ""
        logging = assembly.config.logging
        self._limiter = setup_logging(
            logging.level, logging.format, logging.repeat_window_s, announcer.out
        )

    async def demo(self) -> int:
        """Run beside a controller that drives; return the exit code."""
        self._announcer.waits_for = "the embedded controller"
        async with running_controller(self._assembly.robot) as endpoint:
            self._announcer.waits_for = "its parts and the first ticks"
            self._assembly = demo_assembly(self._assembly, endpoint)
            return await self.robot()

    async def twin(self) -> int:
        """Run beside a "real robot" that changes; return the exit code."""
        async with running_robot() as endpoint:
            self._assembly = twin_assembly(self._assembly, endpoint)
            return await self.robot()

    async def robot(self) -> int:
        """Run until time is over or the scheduler ends; return the exit code."""
        virtual = self._assembly.config.scheduler.backend == "virtual"
        # the duration starts at its first tick
        waits = virtual and self._duration_s is not None
        daemon = Daemon(
            self._assembly,
            self._limiter,
            play=self._play,
            paused=waits,
            links=LINKS_AND_MORE,
        )
        try:
            with self._listening(self._assembly.config.page) as listener:
                if listener is not None:
                    daemon.parts.append(self._page(daemon, listener))
                return await self._run(daemon)
        finally:
            report_repeats(daemon.limiter or self._limiter, at_end=True)

    async def _run(self, starting: Daemon) -> int:
        async with starting as daemon:
            gc.enable()
            self._end_when_asked(daemon)
            watchdog = _make_watchdog(daemon)
            self._announcer.running(daemon)
            if self._page_moved:
                event = Event(EventKind.STATE, 400, "page", self._page_moved)
                daemon.events.publish(event)
            status = self._announcer.showing_status(daemon)
            async with watchdog.watching(), self._reloading(daemon, watchdog), status:
                return await daemon.wait(self._duration_s)

    def _end_when_asked(self, daemon: Daemon) -> None:
        """Let a signal cancel the run, which then unwinds; before, it ends the process at once."""
        loop, task = asyncio.get_running_loop(), asyncio.current_task()

        def end() -> None:
            self._guard.answer()
            if task is not None:
                task.cancel()

        self._guard.on_end(lambda: loop.call_soon_threadsafe(end), daemon.bring_to_rest)

    @contextlib.contextmanager
    def _listening(self, page: PageConfig) -> Iterator[socket.socket | None]:
        """Listen for the page and say where; if that fails, run without the page."""
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
            url = url_of(listener, page.host, is_encrypted=page.tls is not None)
            self._page_moved = moved(listener, page.port)
            self._announcer.page(url, self._page_moved)
            yield listener

    def _page(self, daemon: Daemon, listener: socket.socket) -> PageBeside:
        def setup() -> Any:
            server = daemon.part("opcua")
            endpoint, secret = (
                ("", "") if server is None else (server.url, server.page_secret)
            )
            return page_setup(daemon.assembly, daemon.image.name, endpoint, secret)

        return PageBeside(setup, listener, self._announcer.page_url, daemon.core.tasks)

    @contextlib.asynccontextmanager
    async def _reloading(
        self, daemon: Daemon, watchdog: Watchdog
    ) -> AsyncIterator[None]:
        """Re-read the configuration at SIGHUP; on a terminal a hang-up ends the daemon."""
        if sys.stderr.isatty():
            yield
            return
        reloader = Reloader(daemon, self._announcer.out)

        async def answer(asked: asyncio.Event) -> None:
            while True:
                await asked.wait()
                asked.clear()
                with watchdog.reloading():
                    await reloader.reload()

        with event_loop.hang_ups() as asked:
            job = daemon.core.tasks.keep("reload", lambda: answer(asked))
            try:
                yield
            finally:
                job.cancel()


def _make_watchdog(daemon: Daemon) -> Watchdog:
    control = daemon.control
    return Watchdog(
        heartbeat_ns=lambda: daemon.scheduler.heartbeat_ns,
        ready=lambda: daemon.supervision.first_ticks_met,
        status=lambda: f"{control.state.word}: {control.reason}",
        tasks=daemon.core.tasks,
    )

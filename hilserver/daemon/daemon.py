"""The daemon: surrounds the core with the world, starts it in order, stops it in reverse.

The path of a set-point: `io.opcua_client` or `io.opcua_server` receives it, `core.inputs` checks it
and pushes it into the process image, the paced step latches it and moves the plant, the step
publishes a frame, the publish slice hands the frame to OPC UA and the peers.
"""

import asyncio
import dataclasses
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import AsyncExitStack
from typing import Any, Self

import structlog

from hilserver.core.clock import UtcClock
from hilserver.core.control import Control
from hilserver.core.events import Event, EventKind
from hilserver.daemon import figures
from hilserver.daemon.assembly import Assembly
from hilserver.daemon.builder import Core, Pace, build
from hilserver.daemon.bulletin import Notice, Surroundings
from hilserver.daemon.connections import (
    LINKS,
    make_desk,
    make_http,
    make_metrics,
    make_world,
)
from hilserver.daemon.doors import doors_lost
from hilserver.daemon.outputs import PublishedOutputs
from hilserver.daemon.shadow import GapWatch
from hilserver.daemon.supervision import Supervision
from hilserver.errors import (
    ADDRESSES,
    EXIT_DONE,
    EXIT_FAILED,
    EXIT_SAFETY_LIMIT,
    FailedError,
    UserError,
    address_refused,
)
from hilserver.faults import Play
from hilserver.io.link_status import PeerStatus
from hilserver.io.recorder.launch import recorder_inside, running_recorder
from hilserver.io.recorder.marks import Marks, StateService
from hilserver.io.world import Part, World
from hilserver.kernel import watch_communication
from hilserver.monitoring.audit import audit
from hilserver.monitoring.logging_setup import (
    EXPECTED_ERRORS,
    RepeatLimiter,
    log_event,
    report_repeats,
)
from hilserver.program.giving_back import give_back_code
from hilserver.scheduler import StopReason
from hilserver.scheduler.pacing_virtual import BATCH_TICKS
from hilserver.scheduler.realtime import AuditFinding
from hilserver.signals import State
from hilserver.tasks import Ended, Supervisor, first_of

_log = structlog.get_logger(__name__)
IDLE_PERIOD_S, SIMULATED_POLL_S = 0.1, 0.01
PART_STOP_S = 1.0


class Daemon:
    """Everything that runs, from shared memory to the last socket.

    Use it as an asynchronous context manager; inside, the robot is running.
    """

    def __init__(
        self,
        assembly: Assembly,
        limiter: RepeatLimiter | None = None,
        *,
        play: Play | None = None,
        paused: bool = False,
        links: Sequence[Callable[[World], Iterable[Part]]] = LINKS,
    ) -> None:
        self.assembly = assembly
        self.config = assembly.config
        self.limiter = limiter
        self.audit: list[AuditFinding] = []
        self._play = play
        self._resources = AsyncExitStack()
        self._begun: list[Part] = []
        self._shown_head = 0
        self.core = build(assembly, Pace.configured(assembly, paused=paused))
        self._resources.callback(self.core.close)
        try:
            self._surround(self.core, links)
        except BaseException:
            self.core.close()
            raise

    def _surround(
        self, core: Core, links: Sequence[Callable[[World], Iterable[Part]]]
    ) -> None:
        config = self.config
        self.table = core.table
        self.image = core.image
        self.events = core.events
        self.gate = core.gate
        self.scheduler = core.scheduler
        self.faults = core.faults
        self.clock = UtcClock(simulated=config.scheduler.backend == "virtual")
        self.outputs = PublishedOutputs(core)
        self.control = Control(
            self.table,
            self.image,
            self.gate,
            self.events,
            self.scheduler,
            core.snapshots,
            reset_statistics=self._reset_statistics,
            speed_changed=self._watch_communication,
            measured_pose=self.outputs.measured_pose,
        )
        self.control.before_reset.append(self._expect_room)
        self.control.on_reset.append(self._restart_faults)
        self._watch_communication(speed=1.0)
        self.stage = core.stage()
        if self._play is not None:
            self.stage.check(self._play)
        self.supervision = Supervision(core, self.control)
        self.gaps = GapWatch(
            config.shadow, self.table, self.outputs.model_gap, self.events
        )
        self._states = StateService(core.snapshots, self.image.name, core.tasks)
        self.desk = make_desk(core, self.stage)
        self.control.on_acknowledge = self.desk.scenarios.cut_short
        of = Surroundings(
            core,
            self.clock,
            self.control,
            self.outputs,
            self.desk,
            self.audit,
            self._statuses,
        )
        self._notice = Notice(of)
        world = make_world(of)
        self.parts: list[Part] = [part for make in links for part in make(world)]
        self.metrics = make_metrics(of, self.gaps, lambda: self.config, self.parts)
        self.parts += make_http(core, self.control, self.supervision, self.metrics)

    def parts_of(self, section: str) -> list[Any]:
        """Return the parts that belong to a section of the configuration."""
        return [part for part in self.parts if part.section == section]

    def part(self, section: str) -> Any:
        """Return the only part of a section, None if the configuration has none."""
        return next(iter(self.parts_of(section)), None)

    def _statuses(self) -> list[PeerStatus]:
        """Return what is known about the other end of every link."""
        return [part.status for part in self.parts if part.status is not None]

    # --- start and stop ---------------------------------------------------------------------------

    async def __aenter__(self) -> Self:
        try:
            # What was started ends in reverse order, the plant first.
            ending = self._resources
            self.core.tasks.tell = self._on_task_end
            # whatever a part has left behind
            ending.push_async_callback(self.core.tasks.end)
            ending.callback(self.events.subscribe(log_event))
            ending.callback(self.events.subscribe(self._on_event))
            for why in self.assembly.not_replayable:
                _log.warning("recordings of this run are not replayable", reason=why)
            for remark in self.assembly.remarks + doors_lost(self.config):
                _log.warning(remark)
            await self._start_recorder()
            ending.push_async_callback(self.desk.recordings.close)
            ending.push_async_callback(stop_all, self._begun, self.core.tasks)
            ending.push_async_callback(self.scheduler.stop)
            await self._start_parts(early=True)
            self.scheduler.on_slice("publish", self._publish)
            self.scheduler.on_slice("supervise", self._supervise)
            self.scheduler.on_overrun(self.supervision.on_overrun)
            self.scheduler.after_batch.append(self._show_halt)
            if self._play is not None:
                self.stage.play(self._play.scenario)
            give_back_code()
            await self.scheduler.start()
            self._take_audit()
            await self._start_parts(early=False)
            timeout_s = self.config.scheduler.communication_timeout_ms * 1e-3
            period_s = min(IDLE_PERIOD_S, timeout_s / 4 or IDLE_PERIOD_S)
            ending.callback(self.core.tasks.every("idle", period_s, self._idle).cancel)
            self.control.started()
        except BaseException:
            await self._resources.aclose()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        self.control.stopping("stopping")
        await self._resources.aclose()

    async def _start_parts(self, *, early: bool) -> None:
        for part in self.parts:
            if part.is_early == early:
                self._begun.append(part)
                with self.assembly.at(part.section):
                    try:
                        await part.start()
                    except OSError as error:
                        if error.filename is not None or error.errno not in ADDRESSES:
                            raise
                        raise address_refused(
                            f"{part.section}: cannot start", error
                        ) from None

    def bring_to_rest(self) -> None:
        """Ramp the set-points to zero if the event loop cannot; callable from any thread."""
        watch_communication(self.image, 1)
        time.sleep(self.config.plant.safe_ramp_s)

    async def _start_recorder(self) -> None:
        """Attach the recorder before the first tick; it ends after the last one."""
        if self.clock.simulated:
            marks = Marks(self.image, self.image.name, BATCH_TICKS)
            self.scheduler.after_batch.append(marks.wait)
        if self.config.recording.file is None:
            return
        what = (self.config.recording, self.image.name, self.assembly.folder)
        if self.clock.simulated:

            def tell(why: str) -> None:
                self.events.publish(Event(EventKind.STATE, 700, "recording", why))

            look = self._resources.enter_context(recorder_inside(*what, tell))
            self.scheduler.after_batch.append(look)
        else:
            end = await self._resources.enter_async_context(
                running_recorder(*what, self.core.tasks)
            )

            async def until_it_ends() -> None:
                await end.by_itself.wait()
                raise FailedError(end.why or "the recording has ended by itself")

            watching = self.core.tasks.spawn(until_it_ends, "recording")
            self._resources.callback(watching.cancel)

    def _take_audit(self) -> None:
        """Check what the system granted, publish it and log what is missing."""
        self.audit[:] = audit(self.scheduler)
        self.image.tell(audit=[dataclasses.asdict(item) for item in self.audit])
        missing = [item for item in self.audit if not item.ok]
        if (
            missing and not self.clock.simulated
        ):  # virtual time needs no real-time system
            names = ", ".join(item.name for item in missing)
            _log.warning(
                "degraded",
                missing=names,
                remedies="hilserver latency-test",
                details=figures.audit_table(missing),
            )

    async def wait(self, duration_s: float | None) -> int:
        """Run until the time is up or the scheduler ends; return the exit code.

        In virtual time `duration_s` is simulated time, for a daemon that is paused.
        """
        if self.clock.simulated and duration_s is not None:
            await first_of(self._simulate(duration_s), self._ended())
        else:
            await asyncio.wait({self.scheduler.finished}, timeout=duration_s)
        if not self.scheduler.finished.done():
            return EXIT_DONE
        reason = self.scheduler.finished.result()
        if reason is StopReason.OVERRUN:
            _log.error("stopped by policy 'fail': a tick did not meet its deadline")
            return EXIT_SAFETY_LIMIT
        return EXIT_DONE if reason is StopReason.STOPPED else EXIT_FAILED

    async def _ended(self) -> None:
        await asyncio.wait({self.scheduler.finished})

    async def _simulate(self, duration_s: float) -> None:
        """Run for so much simulated time, however often it is paused meanwhile."""
        n_ticks = max(round(duration_s * 1e9 / self.assembly.base_period_ns), 1)
        self.scheduler.step(n_ticks)
        await self.scheduler.wait_paused()
        while self.scheduler.ticks_done < n_ticks:  # noqa: ASYNC110 - paused, by anybody
            await asyncio.sleep(SIMULATED_POLL_S)

    # --- communication slices ---------------------------------------------------------------------

    def _publish(self, tick: int, _planned_ns: int) -> None:
        self.core.parameters.look_ahead(tick)
        self.outputs.publish(self.control, self.parts)

    def _supervise(self, _tick: int, _planned_ns: int) -> None:
        if (news := self.clock.slew()) is not None:
            self.events.publish(Event(EventKind.STATE, 400, "daemon", news))
        self.supervision.run()
        self.core.tasks.look()
        self.gaps.run()
        self._states.serve()
        self._notice.show()
        for part in self.parts:
            part.supervise()
        if self.limiter is not None:
            report_repeats(self.limiter)

    def _idle(self) -> None:
        """Keep publishing while the plant is paused: no tick makes a slice due then."""
        if self.scheduler.paused:
            self._publish(self.scheduler.tick, 0)
            self._supervise(self.scheduler.tick, 0)

    def _show_halt(self) -> None:
        """Publish the last tick of a step at once: in virtual time, the caller waits for it."""
        if self.scheduler.paused and (head := self.image.head) != self._shown_head:
            self._shown_head = head
            self._publish(self.scheduler.tick, 0)

    # --- messages between the parts ---------------------------------------------------------------

    def _on_task_end(self, ended: Ended) -> None:
        """Name a task that ended although nobody asked it to."""
        is_expected = ended.error is None or isinstance(ended.error, EXPECTED_ERRORS)
        _log.error(str(ended), exc_info=None if is_expected else ended.error)
        is_said = isinstance(ended.error, UserError)  # in a sentence for users
        text = str(ended.error) if is_said else str(ended)
        self.events.publish(Event(EventKind.STATE, 700, ended.name, text))

    def _on_event(self, event: Event) -> None:
        if (
            event.kind in (EventKind.STATE, EventKind.SAFE_STATE)
            and self.scheduler.paused
        ):
            asyncio.get_running_loop().call_soon(self._publish, 0, 0)

    def _expect_room(self) -> None:
        """Before a reset: ControlRefused while the plant has no room for all of it."""
        if self._play is None or self.control.state is State.SAFE:
            self.faults.expect_room()
        else:
            self.stage.expect_room_again(self._play.scenario)

    def _restart_faults(self) -> None:
        """After a reset: clear faults and forces, start the scenario again."""
        self.faults.reset()
        self.core.parameters.schedule()
        if self._play is not None:
            self.stage.play(self._play.scenario)

    def _watch_communication(self, speed: float) -> None:
        """Set the plant's limit of silent ticks to the time-out at this speed."""
        if self.config.scheduler.backend != "virtual":
            self.core.watch_communication(
                self.config.scheduler.communication_timeout_ms, speed
            )

    def _reset_statistics(self) -> None:
        with self.metrics.statistics_reset():
            self.scheduler.statistics.reset()
            self.outputs.end_to_end.clear()


async def stop_all(parts: Sequence[Part], tasks: Supervisor) -> None:
    """Stop all parts concurrently; one that fails or hangs does not delay the others."""
    await asyncio.gather(*(_stop(part, tasks) for part in parts))


async def _stop(part: Part, tasks: Supervisor) -> None:
    stopping = tasks.spawn(part.stop, "stop of a part")
    task = stopping.task
    await asyncio.wait({task}, timeout=PART_STOP_S)
    if not task.done():
        stopping.cancel()  # without waiting: a library may swallow it
        _log.warning("did not stop in time and was abandoned", part=part.label)
    elif not task.cancelled() and (error := task.exception()) is not None:
        _log.error(
            "failed to stop", part=part.label, error=f"{type(error).__name__}: {error}"
        )

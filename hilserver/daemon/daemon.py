"""The daemon: wires the parts, starts them in order, stops them in reverse. Nothing else does.

One set-point on its way: `io.opcua_client` or `io.opcua_server` hears it, `inputs` checks it and
pushes it into the process image, the paced step latches it and moves the plant, the step publishes
a frame, the publish slice hands the frame to OPC UA and the peers.
"""

import asyncio
import dataclasses
import math
import time
from collections.abc import Mapping
from contextlib import AsyncExitStack
from typing import Self

import structlog

from hilserver.compiled.histogram import Histogram125
from hilserver.config.peers import PeerConfig
from hilserver.core import metrics as core_metrics
from hilserver.core.clock import UtcClock
from hilserver.core.control import Control
from hilserver.core.events import Event, EventBus, EventKind
from hilserver.core.inputs import InputGate
from hilserver.core.snapshot import SnapshotStore
from hilserver.daemon import figures, metrics
from hilserver.daemon.assembly import Assembly
from hilserver.daemon.construction import command_limit_ticks, make_image, make_scheduler
from hilserver.daemon.shadow import GapWatch, Pose, measured_pose
from hilserver.daemon.supervision import Supervision
from hilserver.errors import EXIT_DONE, EXIT_FAILED, EXIT_SAFETY_LIMIT
from hilserver.faults import Faults, Line, Play
from hilserver.faults import metrics as fault_metrics
from hilserver.faults.mail import Mailbox
from hilserver.faults.plan import Planner, ShieldFigures
from hilserver.faults.scenario import Stage
from hilserver.image import Frame
from hilserver.io import peer_metrics
from hilserver.io.opcua_client import LinkSecurity, PeerLink
from hilserver.io.opcua_server import OpcUaServer
from hilserver.io.recorder.launch import running_recorder
from hilserver.io.recorder.state_service import StateService
from hilserver.kernel import compose, limit_silence, watch_communication
from hilserver.metrics import Source
from hilserver.monitoring import audit
from hilserver.monitoring.audit import AuditItem
from hilserver.monitoring.health import HealthSources
from hilserver.monitoring.health_http import HttpServer
from hilserver.monitoring.logging_setup import (
    RepeatLimiter,
    log_event,
    report_repeats,
)
from hilserver.monitoring.metrics import Metrics
from hilserver.plant.layout import P_MAX_RPM, P_RPM_PER_M_S, P_RPM_PER_RAD_S
from hilserver.scheduler import StopReason
from hilserver.scheduler import metrics as scheduler_metrics

_log = structlog.get_logger(__name__)
IDLE_PERIOD_S = 0.1


class Daemon:
    """Everything that runs, from shared memory to the last socket.

    Use it as an asynchronous context manager; inside, the robot is running.

    Attributes
    ----------
    table, image, gate, control, events, scheduler
        The parts, for those who build on the daemon (commands, test kit).
    server : OpcUaServer or None
    peers : list of PeerLink
    end_to_end : Histogram125
        Set-point change to the first published output that contains it.
    """

    def __init__(
        self,
        assembly: Assembly,
        limiter: RepeatLimiter | None = None,
        *,
        play: Play | None = None,
        paused: bool = False,
    ) -> None:
        config = assembly.config
        self.assembly, self.config, self.table = assembly, config, assembly.table
        self.end_to_end = Histogram125()
        self.audit: list[AuditItem] = []
        self.limiter = limiter
        self._play, self._paused = play, paused
        self._resources = AsyncExitStack()
        self.clock = UtcClock(simulated=config.scheduler.backend == "virtual")
        self.events = EventBus()
        self.image = make_image(assembly)
        self._resources.callback(self.image.close)
        try:
            self._wire()
        except BaseException:
            self.image.close()
            raise

    def _wire(self) -> None:
        assembly, config = self.assembly, self.config
        self.image.warm_up()
        step = compose(assembly.composition, self.image)
        self._watch_communication(speed=1.0)
        limit_silence(self.image, command_limit_ticks(assembly))
        self.scheduler = make_scheduler(assembly, self.image, step, paused=self._paused)
        self.gate = InputGate(
            self.table,
            self.image,
            self.events,
            owner=config.control.source or ("peer" if config.peers else "opcua"),
            priority=config.control.priority,
        )
        self.snapshots = SnapshotStore(
            self.image, assembly.folder / config.snapshots.folder, dict(assembly.identity)
        )
        self._states = StateService(self.snapshots, self.image.name)
        self.image.tell(identity=self.snapshots.identity)
        self.control = self._make_control()
        self.lines = {peer.name: Line(peer.name) for peer in config.peers}
        self.faults = self._make_faults()
        self.stage = Stage(self.table, self.image, self.gate, self.faults, assembly.base_period_ns)
        if self._play is not None:
            self.stage.check(self._play)
        self.control.on_reset.append(self._restart_faults)
        self.supervision = Supervision(
            config,
            self.gate,
            self.control,
            self.events,
            self.scheduler,
            self.image,
            timeout_is_dead=lambda: self.faults.timeout_is_dead,
        )
        self.gaps = GapWatch(config.shadow, self.table, self._model_gap, self.events)
        self.peers = [self._make_peer(peer) for peer in config.peers]
        self.server = self._make_server() if config.opcua.enabled else None
        self.metrics = self._make_metrics()
        self.http = self._make_http() if config.metrics.enabled else None
        self._frame: Frame | None = None

    # --- start and stop ---------------------------------------------------------------------------

    async def __aenter__(self) -> Self:
        try:
            await self._start()
        except BaseException:
            await self._resources.aclose()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        self.control.stopping("stopping")
        await self._resources.aclose()

    async def _start(self) -> None:
        self._resources.callback(self.events.subscribe(log_event))
        self._resources.callback(self.events.subscribe(self._on_event))
        await self._start_recorder()
        if self.http is not None:
            await self.http.start()
            self._resources.push_async_callback(self.http.stop)
        if self.server is not None:
            await self.server.start()
            self._resources.push_async_callback(self.server.stop)
        self.scheduler.on_slice("publish", self._publish)
        self.scheduler.on_slice("supervise", self._supervise)
        self.scheduler.on_overrun(self.supervision.on_overrun)
        self._resources.push_async_callback(self.scheduler.stop)
        if self._play is not None:
            self.stage.play(self._play.scenario)
        await self.scheduler.start()
        self.audit = audit.audit(self.scheduler)
        self._tell_audit()
        self.image.tell(audit=[dataclasses.asdict(item) for item in self.audit])
        for peer in self.peers:
            self.gate.expect(peer.config.inputs)
            await peer.start()
            self._resources.push_async_callback(peer.stop)
        idle = asyncio.create_task(self._idle(), name="idle")
        self._resources.callback(idle.cancel)
        self.control.started()

    async def _start_recorder(self) -> None:
        """Attach the recorder before the first tick; it ends after the last one."""
        if self.config.recording.file is not None:
            recorder = running_recorder(
                self.config.recording, self.image.name, self.assembly.folder
            )
            await self._resources.enter_async_context(recorder)

    async def wait(self, duration_s: float | None, asked: asyncio.Event) -> int:
        """Run until `asked` is set, time is over or the scheduler ends; return the exit code."""
        until = asyncio.create_task(asked.wait())
        try:
            await asyncio.wait(
                (until, self.scheduler.finished),
                timeout=duration_s,
                return_when=asyncio.FIRST_COMPLETED,
            )
        finally:
            until.cancel()
        if not self.scheduler.finished.done():
            return EXIT_DONE
        reason = self.scheduler.finished.result()
        if reason is StopReason.OVERRUN:
            _log.error("stopped by policy 'fail': a tick did not meet its deadline")
            return EXIT_SAFETY_LIMIT
        return EXIT_DONE if reason is StopReason.STOPPED else EXIT_FAILED

    # --- communication slices ---------------------------------------------------------------------

    def _publish(self, _tick: int, _planned_ns: int) -> None:
        self.image.control.heartbeat += 1
        frame = self.image.latest()
        if frame is None:
            return
        frame.values[self.table.slot("sim.state")] = self.control.state
        self._frame = frame
        if self.server is not None:
            self.server.publish(frame)
        received_ns = self.gate.take_change(frame.latched_rows)
        if received_ns is not None:
            self.end_to_end.observe(time.monotonic_ns() - received_ns)

    def _supervise(self, _tick: int, _planned_ns: int) -> None:
        self.clock.slew()
        self.supervision.run()
        self.gaps.run()
        self._states.serve()
        if self.server is not None:
            self.server.publish_diagnostics()
        if self.limiter is not None:
            report_repeats(self.limiter)

    async def _idle(self) -> None:
        """Keep publishing while the plant stands still: no tick makes a slice due then."""
        timeout_s = self.config.scheduler.communication_timeout_ms * 1e-3
        period_s = min(IDLE_PERIOD_S, timeout_s / 4 or IDLE_PERIOD_S)
        while True:
            await asyncio.sleep(period_s)
            if self.scheduler.paused:
                self._publish(self.scheduler.tick, 0)
                self._supervise(self.scheduler.tick, 0)

    # --- what the parts tell each other -----------------------------------------------------------

    def _on_event(self, event: Event) -> None:
        if event.kind in (EventKind.STATE, EventKind.SAFE_STATE) and self.scheduler.paused:
            asyncio.get_running_loop().call_soon(self._publish, 0, 0)
        if event.kind is EventKind.STATE:
            self.supervision.act_on_silence()

    def _restart_faults(self) -> None:
        """After a reset: no fault, no force, and the scenario from its beginning."""
        self.faults.reset()
        if self._play is not None:
            self.stage.play(self._play.scenario)

    def _read_output(self, name: str) -> tuple[float | list[float], int, int]:
        frame, slots = self._frame, list(self.table[name].slots)
        if frame is None:
            raise LookupError("no frame yet")
        values, status = frame.values[slots].tolist(), int(frame.status[slots].max())
        return values if len(slots) > 1 else values[0], status, frame.planned_ns

    def _tell_audit(self) -> None:
        for item in self.audit:
            if not item.ok:
                _log.warning(
                    "degraded",
                    item=item.name,
                    found=item.found,
                    wanted=item.wanted,
                    remedy=item.remedy,
                )

    # --- construction -----------------------------------------------------------------------------

    def _make_control(self) -> Control:
        config, assembly = self.config, self.assembly
        return Control(
            self.table,
            self.image,
            self.gate,
            self.events,
            self.scheduler,
            self.snapshots,
            safe_ramp_ticks=round(config.plant.safe_ramp_s * 1e9 / assembly.base_period_ns),
            reset_statistics=self._reset_statistics,
            speed_changed=self._watch_communication,
            measured_pose=self._measured_pose,
        )

    def _watch_communication(self, speed: float) -> None:
        """Let the plant count ticks of silence: as many as pass in the time-out at this speed."""
        if self.config.scheduler.backend != "virtual":
            timeout_ns = self.config.scheduler.communication_timeout_ms * 1e6 * speed
            watch_communication(self.image, math.ceil(timeout_ns / self.assembly.base_period_ns))

    def _make_faults(self) -> Faults:
        p = self.assembly.composition.parameters
        shield = ShieldFigures(p[P_RPM_PER_M_S], p[P_RPM_PER_RAD_S], p[P_MAX_RPM])
        return Faults(
            self.table,
            Mailbox(self.image),
            Planner(self.table, self.assembly.base_period_ns, shield),
            self.events,
            tick=lambda: self.scheduler.tick,
            lines=self.lines,
        )

    def _reset_statistics(self) -> None:
        with self.metrics.statistics_reset():
            self.scheduler.statistics.reset()
            self.end_to_end.clear()

    def _model_gap(self) -> Mapping[str, float]:
        return figures.model_gap(self.gate, self.table, self._frame)

    def _measured_pose(self) -> Pose | None:
        parameters = self.assembly.composition.parameters
        return measured_pose(self.gate.newest, self.table, self.image.latest(), parameters)

    def _state_name(self) -> str:
        return self.control.state.word

    def _make_peer(self, config: PeerConfig) -> PeerLink:
        return PeerLink(
            config,
            gate=self.gate,
            on_stale=self.supervision.on_stale,
            on_restored=self.supervision.on_restored,
            events=self.events,
            read_output=self._read_output,
            clock=self.clock,
            line=self.lines[config.name],
            security=LinkSecurity(config, self.config.opcua, self.assembly.folder),
        )

    def _make_server(self) -> OpcUaServer:
        return OpcUaServer(
            self.config.opcua,
            self.table,
            self.image,
            self.gate,
            self.control,
            self.events,
            self.clock,
            statistics=lambda: figures.slice_table(self.scheduler),
            peers=lambda: figures.peer_table(peer.status for peer in self.peers),
            audit=lambda: figures.audit_table(self.audit),
            faults=self.faults,
            folder=self.assembly.folder,
        )

    def _make_metrics(self) -> Metrics:
        return Metrics(
            Source(scheduler_metrics.METRICS, lambda: scheduler_metrics.pace(self.scheduler)),
            Source(core_metrics.STATE_METRICS, lambda: self.control.state),
            Source(core_metrics.INPUT_METRICS, lambda: core_metrics.inputs(self.gate)),
            Source(peer_metrics.METRICS, lambda: [peer.status for peer in self.peers]),
            Source(metrics.LATENCY_METRICS, lambda: self.end_to_end),
            Source(metrics.GAP_METRICS, self._model_gap),
            Source(metrics.ALARM_METRICS, lambda: self.gaps.alarms),
            Source(fault_metrics.METRICS, self.faults.counts),
            Source(audit.METRICS, lambda: {item.name: item.ok for item in self.audit}),
            Source(metrics.PROGRAM_METRICS, self._program),
        )

    def _program(self) -> metrics.Program:
        return metrics.Program(self.config.sha256, len(asyncio.all_tasks()))

    def _make_http(self) -> HttpServer:
        health = HealthSources(
            state=self._state_name,
            heartbeat_ns=lambda: self.scheduler.heartbeat_ns,
            first_ticks_met=lambda: self.supervision.first_ticks_met,
        )
        config = self.config.metrics
        return HttpServer(
            host=config.host,
            port=config.port,
            render=self.metrics.render,
            health=health,
            host_names=config.host_names,
        )

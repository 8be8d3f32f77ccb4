"""What connects a robot with the world: peers, OPC UA server, metrics, health."""

import asyncio
from collections.abc import Callable, Sequence

from hilserver.config.root import Config
from hilserver.core import metrics as core_metrics
from hilserver.core.clock import UtcClock
from hilserver.core.control import Control
from hilserver.daemon import figures, metrics
from hilserver.daemon.builder import Core
from hilserver.daemon.bulletin import Bulletin, Notice
from hilserver.daemon.desk import Desk, Recordings, Scenarios
from hilserver.daemon.outputs import Outputs
from hilserver.daemon.patches import Patches
from hilserver.daemon.shadow import GapWatch
from hilserver.daemon.supervision import Supervision
from hilserver.faults import metrics as fault_metrics
from hilserver.faults.scenario import Stage
from hilserver.io import peer_metrics
from hilserver.io.opcua_client import LinkSecurity, PeerLink
from hilserver.io.opcua_server.server import OpcUaServer
from hilserver.io.peer_status import PeerStatus
from hilserver.io.shield import ShieldLink
from hilserver.io.shield import metrics as shield_metrics
from hilserver.metrics import Source
from hilserver.monitoring.audit import METRICS as AUDIT_METRICS
from hilserver.monitoring.audit import AuditItem
from hilserver.monitoring.health import HealthSources
from hilserver.monitoring.health_http import HttpServer
from hilserver.monitoring.metrics import Metrics
from hilserver.scheduler import metrics as scheduler_metrics


def make_peers(
    core: Core, clock: UtcClock, outputs: Outputs, supervision: Supervision
) -> list[PeerLink]:
    """Return a link for every configured peer."""
    assembly, links = core.assembly, []
    for index, peer in enumerate(assembly.config.peers):
        with assembly.at("peers", index):
            security = LinkSecurity(peer, assembly.config.opcua, assembly.folder)
        links.append(
            PeerLink(
                peer,
                gate=core.gate,
                on_stale=supervision.on_stale,
                events=core.events,
                read_output=outputs.read,
                clock=clock,
                line=core.lines[peer.name],
                security=security,
            )
        )
    return links


def make_desk(core: Core, stage: Stage) -> Desk:
    """Return what starts scenarios, recordings and patches by name."""
    assembly, scheduler = core.assembly, core.scheduler
    folders, config = assembly.config.folders, assembly.config
    return Desk(
        Scenarios(
            assembly.folder / folders.scenarios,
            stage,
            core.gate,
            core.faults,
            lambda: scheduler.tick,
            assembly.base_period_ns * 1e-9,
        ),
        Recordings(assembly.folder / folders.recordings, config.recording, core.image.name),
        Patches(assembly.folder / folders.patches, core),
    )


def make_notice(
    core: Core,
    control: Control,
    outputs: Outputs,
    peers: Callable[[], Sequence[PeerStatus]],
    audit: Sequence[AuditItem],
    desk: Desk,
) -> Notice:
    """Return what keeps the board of the image up to date."""
    bulletin = Bulletin(
        control,
        core.gate,
        core.scheduler,
        core.events,
        core.faults,
        peers=peers,
        audit=lambda: audit,
        gaps=outputs.model_gap,
        patch=lambda: desk.patches.loaded,
        patch_notice=lambda: desk.patches.notice,
        scenario=desk.scenarios.view,
        recording=desk.recordings.view,
    )
    return Notice(core.image, bulletin)


def make_server(
    core: Core,
    clock: UtcClock,
    control: Control,
    peers: Callable[[], Sequence[PeerStatus]],
    audit: Sequence[AuditItem],
    desk: Desk,
) -> OpcUaServer | None:
    """Return the OPC UA server, None where the configuration has none."""
    assembly = core.assembly
    if not assembly.config.opcua.enabled:
        return None
    with assembly.at("blocks"):  # a name or a unit of theirs that cannot be shown
        return OpcUaServer(
            assembly.config.opcua,
            core.table,
            core.image,
            core.gate,
            control,
            core.events,
            clock,
            statistics=lambda: figures.slice_table(core.scheduler),
            peers=lambda: figures.peer_table(peers()),
            audit=lambda: figures.audit_table(audit),
            faults=core.faults,
            files=desk,
            folder=assembly.folder,
        )


def make_metrics(
    core: Core,
    control: Control,
    outputs: Outputs,
    peers: Callable[[], Sequence[PeerStatus]],
    shield: ShieldLink | None,
    gaps: GapWatch,
    audit: Sequence[AuditItem],
    config: Callable[[], Config],
) -> Metrics:
    """Return the metrics; `config` is asked anew each time, as a reload changes it."""
    scheduler = core.scheduler
    return Metrics(
        Source(scheduler_metrics.METRICS, lambda: scheduler_metrics.pace(scheduler)),
        Source(core_metrics.STATE_METRICS, lambda: control.state),
        Source(core_metrics.INPUT_METRICS, lambda: core_metrics.inputs(core.gate)),
        Source(peer_metrics.METRICS, peers),
        Source(shield_metrics.METRICS, lambda: [] if shield is None else [shield.status]),
        Source(metrics.LATENCY_METRICS, lambda: outputs.end_to_end),
        Source(metrics.GAP_METRICS, outputs.model_gap),
        Source(metrics.OUTPUT_METRICS, outputs.exported),
        Source(metrics.ALARM_METRICS, lambda: gaps.alarms),
        Source(fault_metrics.METRICS, core.faults.counts),
        Source(AUDIT_METRICS, lambda: {item.name: item.ok for item in audit}),
        Source(
            metrics.PROGRAM_METRICS,
            lambda: metrics.Program(config().sha256, len(asyncio.all_tasks())),
        ),
    )


def make_http(
    core: Core, control: Control, supervision: Supervision, exported: Metrics
) -> HttpServer | None:
    """Return the HTTP server of metrics and health, None where the configuration has none."""
    config = core.assembly.config.metrics
    if not config.enabled:
        return None
    health = HealthSources(
        state=lambda: control.state.word,
        heartbeat_ns=lambda: core.scheduler.heartbeat_ns,
        first_ticks_met=lambda: supervision.first_ticks_met,
    )
    return HttpServer(
        host=config.host,
        port=config.port,
        render=exported.render,
        health=health,
        host_names=config.host_names,
    )

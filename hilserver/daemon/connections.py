"""Connects a robot with the world: its links, what they need, metrics, health."""

import asyncio
from collections.abc import Callable, Iterable, Iterator, Sequence

from hilserver.body.export import robot_urdf
from hilserver.config.root import Config
from hilserver.core import metrics as core_metrics
from hilserver.core.control import Control
from hilserver.daemon import figures, metrics
from hilserver.daemon.builder import Core
from hilserver.daemon.bulletin import Surroundings
from hilserver.daemon.desk import Desk, Recordings, Scenarios
from hilserver.daemon.patches import Patches
from hilserver.daemon.shadow import GapWatch
from hilserver.daemon.supervision import Supervision
from hilserver.faults import metrics as fault_metrics
from hilserver.faults.scenario import ScenarioPlayer
from hilserver.io import edge, foxglove, ros2, s7, shared_memory
from hilserver.io.opcua_server import server as opcua_server
from hilserver.io.peer_link import metrics as peer_metrics
from hilserver.io.peers import parts as peer_parts
from hilserver.io.ros2 import metrics as ros2_metrics
from hilserver.io.ros2.status import Ros2Status
from hilserver.io.shield import link as shield
from hilserver.io.shield import metrics as shield_metrics
from hilserver.io.shield.status import ShieldStatus
from hilserver.io.world import Part, World
from hilserver.metrics import MetricSource
from hilserver.monitoring.audit import METRICS as AUDIT_METRICS
from hilserver.monitoring.health_http import HealthSources, HttpServer
from hilserver.monitoring.metrics import Metrics
from hilserver.observer import metrics as observer_metrics
from hilserver.observer.layout import Head
from hilserver.ros.robot import Shape
from hilserver.scheduler import metrics as scheduler_metrics

LINKS: tuple[Callable[[World], Iterable[Part]], ...] = (
    opcua_server.parts,
    ros2.parts,
    shield.parts,
    foxglove.parts,
    edge.parts,
    s7.parts,
    shared_memory.parts,
    peer_parts,
)
"""Every link, in the order of the banner; a new one takes one line here."""


def make_world(of: Surroundings) -> World:
    """Return what links need of the robot."""
    core = of.core
    outputs = of.outputs
    desk = of.desk
    assembly = core.assembly
    parameters = assembly.composition.parameters
    return World(
        config=assembly.config,
        folder=assembly.folder,
        at=assembly.at,
        table=core.table,
        image=core.image,
        gate=core.gate,
        events=core.events,
        clock=of.clock,
        control=of.control,
        faults=core.faults,
        parameters=core.parameters,
        lines=core.lines,
        robot=assembly.robot,
        shape=Shape.of(assembly.robot, parameters),
        hall=assembly.composition.hall,
        period_ns=assembly.base_period_ns,
        pacing_thread=lambda: core.scheduler.thread_id,
        description=lambda prefix: robot_urdf(assembly.body, prefix),
        read_output=outputs.read,
        tables={
            "slices": lambda: figures.slice_table(core.scheduler),
            "peers": lambda: figures.peer_table(of.peers()),
            "audit": lambda: figures.audit_table(of.audit),
            # evaluated at each call: a part may set its own later
            "recalibration": lambda: desk.recalibration.table(),  # noqa: PLW0108
        },
        files=desk,
        tasks=core.tasks,
    )


def make_desk(core: Core, stage: ScenarioPlayer) -> Desk:
    """Return what starts scenarios, recordings and patches by name."""
    assembly = core.assembly
    config = core.assembly.config
    folders = config.folders
    scenarios = Scenarios(assembly.folder / folders.scenarios, stage, core)
    folder = assembly.folder / folders.recordings
    recordings = Recordings(
        folder,
        config.recording,
        core.image.name,
        core.tasks,
    )
    patches = Patches(assembly.folder / folders.patches, core)
    return Desk(scenarios, recordings, patches)


def make_metrics(
    of: Surroundings,
    gaps: GapWatch,
    config: Callable[[], Config],
    links: Sequence[Part],
) -> Metrics:
    """Return the metrics; `config` is called each time, as a reload changes it."""
    core = of.core
    outputs = of.outputs
    scheduler = of.core.scheduler
    return Metrics(
        MetricSource(
            scheduler_metrics.METRICS, lambda: scheduler_metrics.pace(scheduler)
        ),
        MetricSource(core_metrics.STATE_METRICS, lambda: of.control.state),
        MetricSource(
            core_metrics.PARAMETER_METRICS, lambda: len(core.parameters.differing)
        ),
        MetricSource(
            core_metrics.INPUT_METRICS, lambda: core_metrics.inputs(core.gate)
        ),
        MetricSource(peer_metrics.METRICS, of.peers),
        MetricSource(
            shield_metrics.METRICS,
            lambda: [p for p in of.peers() if isinstance(p, ShieldStatus)],
        ),
        MetricSource(
            ros2_metrics.METRICS,
            lambda: [p for p in of.peers() if isinstance(p, Ros2Status)],
        ),
        MetricSource(metrics.LATENCY_METRICS, lambda: outputs.end_to_end),
        MetricSource(metrics.GAP_METRICS, outputs.model_gap),
        MetricSource(metrics.OUTPUT_METRICS, outputs.exported),
        MetricSource(metrics.ALARM_METRICS, lambda: gaps.alarms),
        MetricSource(fault_metrics.METRICS, core.faults.counts),
        MetricSource(observer_metrics.METRICS, lambda: _observed(core)),
        MetricSource(AUDIT_METRICS, lambda: {item.name: item.ok for item in of.audit}),
        MetricSource(metrics.TASK_METRICS, lambda: core.tasks),
        MetricSource(
            metrics.PROGRAM_METRICS,
            lambda: metrics.Program(config().sha256, len(asyncio.all_tasks())),
        ),
        *(source for link in links for source in link.metrics),
    )


def _observed(core: Core) -> list[Head]:
    """Return the counts of the observer, if it runs."""
    if core.assembly.composition.observer is None:
        return []
    return [observer_metrics.counted(core.image.region("observer")[0])]


class MetricsEndpoint(HttpServer, Part):
    """The HTTP server of metrics and health."""

    section = label = "metrics"
    is_early = True


def make_http(
    core: Core, control: Control, supervision: Supervision, exported: Metrics
) -> Iterator[MetricsEndpoint]:
    """Yield the HTTP server of metrics and health, if the configuration has one."""
    config = core.assembly.config.metrics
    if not config.enabled:
        return
    health = HealthSources(
        state=lambda: control.state.word,
        heartbeat_ns=lambda: core.scheduler.heartbeat_ns,
        first_ticks_met=lambda: supervision.first_ticks_met,
        tasks_down=core.tasks.why_down,
    )
    yield MetricsEndpoint(
        host=config.host,
        port=config.port,
        render=exported.render,
        health=health,
        host_names=config.host_names,
        tasks=core.tasks,
    )

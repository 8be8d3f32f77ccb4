"""The one builder: from an assembly to a robot that can be paced. Nothing else assembles these.

The daemon, a replay and the tests run the same parts; they differ in how these are paced and in
what surrounds them. `Pace` defines the former::

    async with build(assembly) as core:            # paused, in virtual time
        await core.scheduler.advance(1000)
"""

import math
import os
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Self

from hilserver.config.root import Config
from hilserver.config.timing import LimitsConfig
from hilserver.core.events import EventBus
from hilserver.core.inputs import InputGate
from hilserver.core.leases import TELEOP, Leases
from hilserver.core.parameters import LiveParameters, Start
from hilserver.core.snapshot import SnapshotStore
from hilserver.daemon.assembled import end_models, with_models
from hilserver.daemon.assembly import Assembly
from hilserver.faults import Faults, PeerLine
from hilserver.faults.mail import Mailbox
from hilserver.faults.plan import Planner, ShieldFigures
from hilserver.faults.scenario import ScenarioPlayer
from hilserver.image import ProcessImage, board, leases
from hilserver.image.shared_file import MADE_UP
from hilserver.kernel import compose, limit_silence, watch_communication
from hilserver.kernel.composition import Foreign
from hilserver.plant.layout import Parameters
from hilserver.scheduler import (
    OverrunLimits,
    OverrunPolicy,
    RealtimeSettings,
    Scheduler,
    StepFunction,
    words_needed,
)
from hilserver.signals import SignalTable
from hilserver.tasks import Supervisor

LINEAR_BINS = 10_000
VIRTUAL_RING = 2048  # frames that are read between two batches of virtual time
PUBLISHED_AHEAD = 2
"""How many publish slices before its tick a scheduled change of parameters is packed."""
OTHER_LEASES = 3  # of sources that are not links, see `leases_of`
UNDEMANDING = RealtimeSettings(priority=0, lock_memory=False, hold_latency_target=False)
"""Asks nothing of the operating system."""


@dataclass(frozen=True, kw_only=True)
class Pace:
    """Pacing and capacity of the parts; by default in virtual time, paused at the start."""

    backend: str = "virtual"
    image: str = MADE_UP  # name of the process image; `MADE_UP`: a unique one
    # frames kept and rows that fit into each input queue; powers of two
    ring_frames: int = 1 << 14
    queue_rows: int = 1 << 13
    policy: OverrunPolicy = field(default_factory=OverrunPolicy)
    limits: OverrunLimits = field(default_factory=OverrunLimits)
    realtime: RealtimeSettings = UNDEMANDING
    # ticks without a set-point before they go to zero; 0: never
    command_limit_ticks: int = 0
    paused: bool = True
    freeze_gc: bool = False

    @classmethod
    def configured(cls, assembly: Assembly, *, paused: bool = False) -> Self:
        """Return the pace that the configuration asks for."""
        config = assembly.config
        scheduler = assembly.config.scheduler
        least = VIRTUAL_RING if scheduler.backend == "virtual" else 0
        timeout_ms = config.control.command_timeout_ms
        ring_frames = max(config.image.ring_frames, least)
        limit_ticks = (
            0
            if timeout_ms is None
            else max(1, round(timeout_ms * 1e6 / assembly.base_period_ns))
        )
        return cls(
            backend=scheduler.backend,
            image=config.image.name,
            ring_frames=ring_frames,
            policy=OverrunPolicy(scheduler.policy, scheduler.catch_up_limit),
            limits=overrun_limits(scheduler.limits),
            realtime=RealtimeSettings(**scheduler.realtime.model_dump()),
            command_limit_ticks=limit_ticks,
            paused=paused,
            freeze_gc=True,
        )


def overrun_limits(limits: LimitsConfig) -> OverrunLimits:
    """Return the limits as the scheduler takes them: null switches one off."""
    return OverrunLimits(
        single_ns=round((limits.single_overrun_ms or 0) * 1e6),
        consecutive=limits.consecutive_overruns or 0,
    )


@dataclass(frozen=True)
class Core:
    """The parts that every robot has, whatever surrounds it.

    As an asynchronous context manager it runs the scheduler and frees the memory at the end.
    """

    assembly: Assembly
    image: ProcessImage
    step: StepFunction  # what the scheduler calls; kept for tests that call its phases
    scheduler: Scheduler
    events: EventBus
    gate: InputGate
    snapshots: SnapshotStore
    parameters: LiveParameters
    lines: Mapping[str, PeerLine]  # where faults of peer links act, by name of the peer
    faults: Faults
    tasks: Supervisor  # keeps every task of the daemon

    @property
    def table(self) -> SignalTable:
        """Every signal of the robot."""
        return self.assembly.table

    def stage(self) -> ScenarioPlayer:
        """Return what plays scenarios."""
        period_ns = self.assembly.base_period_ns
        return ScenarioPlayer(
            self.table, self.image, self.gate, self.faults, self.parameters, period_ns
        )

    def watch_communication(self, timeout_ms: float, speed: float = 1.0) -> None:
        """Let the plant go to the safe state after `timeout_ms` without a heartbeat."""
        ticks = math.ceil(timeout_ms * 1e6 * speed / self.assembly.base_period_ns)
        watch_communication(self.image, ticks)

    async def __aenter__(self) -> Self:
        try:
            await self.scheduler.start()
        except BaseException:
            self.close()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.scheduler.stop()
        self.close()

    @property
    def foreign(self) -> Mapping[str, Foreign]:
        """Running models of others, by the name of their block."""
        blocks = self.assembly.composition.blocks
        return {
            block.name: block.foreign for block in blocks if block.foreign is not None
        }

    def close(self) -> None:
        """Free the memory and end the models of others; nothing is paced any more."""
        end_models(self.assembly)
        self.image.close()


def build(assembly: Assembly, pace: Pace | None = None) -> Core:
    """Build the parts of `assembly`; compiles the step, or takes it from the cache."""
    pace = Pace() if pace is None else pace
    plant = pace.realtime if pace.backend == "thread" else UNDEMANDING
    assembly = with_models(assembly, plant, waits=pace.backend == "virtual")
    with ExitStack() as begun:
        begun.callback(end_models, assembly)
        is_made_up = pace.image == MADE_UP
        composition = assembly.composition
        held = leases.words_needed(OTHER_LEASES + len(assembly.config.drivers))
        statistics = words_needed(len(assembly.slices), LINEAR_BINS)
        name = (
            f"{MADE_UP}-{os.getpid()}-{time.monotonic_ns()}"
            if is_made_up
            else pace.image
        )
        fixed = composition.fixed_regions | {
            "statistics": statistics,
            board.REGION: board.WORDS,
            leases.REGION: held,
        }
        image = ProcessImage(
            name,
            assembly.table,
            live=composition.live_regions,
            fixed=fixed,
            base_period_ns=assembly.base_period_ns,
            ring_length=pace.ring_frames,
            queue_rows=pace.queue_rows,
            run=assembly.provenance,
        )
        begun.callback(image.close)
        core = _core(assembly, pace, image)
        begun.pop_all()
    return core


def _core(assembly: Assembly, pace: Pace, image: ProcessImage) -> Core:
    config = assembly.config
    table = assembly.table
    step = compose(assembly.composition, image)
    limit_silence(image, pace.command_limit_ticks)
    tasks = Supervisor()
    scheduler = _scheduler(assembly, pace, image, step, tasks)
    events = EventBus(lambda: scheduler.tick * assembly.base_period_ns * 1e-9)
    gate = InputGate(
        table,
        image,
        events,
        leases_of(config, image, assembly.base_period_ns, pace),
        owner=config.first_source,
        priority=config.sources,
        fallback=config.control.fallback,
        named=_named_sources(config),
        doors=config.doors,
        waits_for_start=config.waits_for_start,
    )
    folder = assembly.folder / config.snapshots.folder
    snapshots = SnapshotStore(image, folder, dict(assembly.identity))
    image.tell(identity=snapshots.identity)
    start = Start(assembly.robot, assembly.configured, assembly.composition)
    publish = next(s.period_ticks for s in assembly.slices if s.name == "publish")
    parameters = LiveParameters(
        start, image, snapshots, events, PUBLISHED_AHEAD * publish
    )
    ours = [o.name for o in config.drivers if o.is_enabled and o.has_faults]
    lines = {name: PeerLine(name) for name in ours}
    packed = assembly.composition.parameters
    period_ns = assembly.base_period_ns
    faults = faults_of(
        image, table, period_ns, packed, events, lambda: scheduler.tick, lines
    )
    return Core(
        assembly,
        image,
        step,
        scheduler,
        events,
        gate,
        snapshots,
        parameters,
        lines,
        faults,
        tasks,
    )


def _named_sources(config: Config) -> list[str]:
    """Return the sources that metrics name: the configuration's, none that a client makes."""
    own = [source for source in config.sources if source != "peer"]
    return sorted({*own, *(o.source for o in config.drivers if o.is_enabled)})


def faults_of(
    image: ProcessImage,
    table: SignalTable,
    period_ns: int,
    p: Parameters,
    events: EventBus,
    tick: Callable[[], int] = lambda: 0,
    lines: Mapping[str, PeerLine] | None = None,
) -> Faults:
    """Return what injects faults into an image of a robot with these parameters."""
    planner = Planner(
        table, period_ns, ShieldFigures(p.rpm_per_m_s, p.rpm_per_rad_s, p.max_rpm)
    )
    return Faults(table, Mailbox(image), planner, events, tick=tick, lines=lines or {})


def leases_of(
    config: Config, image: ProcessImage, period_ns: int, pace: Pace
) -> Leases:
    """Return leases for every source of a configuration, before the first tick."""
    clock = time.monotonic_ns if pace.backend != "virtual" else lambda: 0
    found = Leases(image, round(config.plant.safe_ramp_s * 1e9 / period_ns), clock)
    found.add("opcua", config.control.opcua_stale_after_ms, "ramp")
    found.add(TELEOP, config.page.deadman_ms, "zero")
    found.add("page", config.page.deadman_ms, "zero")
    for driver in config.drivers:
        found.add(driver.source, driver.limit_ms, driver.policy)
    return found


def _scheduler(
    assembly: Assembly,
    pace: Pace,
    image: ProcessImage,
    step: StepFunction,
    tasks: Supervisor,
) -> Scheduler:
    _, statistics = image.region("statistics")
    return Scheduler(
        base_period_ns=assembly.base_period_ns,
        slices=assembly.slices,
        step=step,
        values=image.values,
        words=image.words,
        backend=pace.backend,
        policy=pace.policy,
        limits=pace.limits,
        realtime=pace.realtime,
        statistics_array=statistics,
        linear_bins=LINEAR_BINS,
        paused=pace.paused,
        freeze_gc=pace.freeze_gc,
        tasks=tasks,
    )

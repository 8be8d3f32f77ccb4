"""Plain figures that stand in for a daemon: what the sources are, not what they do."""

import math
from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilserver.compiled.histogram import N_BUCKETS, Histogram125
from hilserver.core import metrics as core
from hilserver.core.recalibration import RECALIBRATION_METRICS, Figures
from hilserver.core.refusal import reasons_of
from hilserver.daemon import metrics as daemon
from hilserver.daemon.outputs import EXPORTED
from hilserver.faults import metrics as faults
from hilserver.io.link_status import PeerStatus
from hilserver.io.peer_link import metrics as peer_metrics
from hilserver.io.peer_link.samples import FaultKind
from hilserver.io.ros2 import metrics as ros2_metrics
from hilserver.io.ros2.status import Ros2Status
from hilserver.io.shield import metrics as shield_metrics
from hilserver.io.shield.status import ShieldStatus
from hilserver.metrics import MetricSource
from hilserver.monitoring import audit
from hilserver.observer import metrics as observer
from hilserver.observer.layout import N_HEAD
from hilserver.scheduler import metrics as scheduler
from hilserver.scheduler.statistics import LatencyWindow, SliceFigures
from hilserver.signals import State
from hilserver.tasks import Supervisor

OF_S7 = {FaultKind.TORN_READ, FaultKind.NO_SLOT, FaultKind.NO_S7, FaultKind.NO_ROOM}
SLICES = ("plant", "sensors", "publish", "supervise", "own")


def zeros() -> NDArray[np.int64]:
    return np.zeros(N_BUCKETS, dtype=np.int64)


def slice_figures(name: str, **figures: object) -> SliceFigures:
    """The scheduler's own record of a slice, all zero but for `figures`."""
    numbers = dict.fromkeys(
        (f for f in SliceFigures.__dataclass_fields__ if f not in {"name", "window"}), 0
    )
    histograms = {"latency_counts": zeros(), "execution_counts": zeros()}
    window = LatencyWindow(0, math.nan, math.nan, math.nan, math.nan)
    unknown = {"margin_min_ns": None, "window": window}
    return SliceFigures(**{"name": name, **numbers, **histograms, **unknown, **figures})


class FakeDaemon:
    """Everything a scrape reads, settable."""

    def __init__(self) -> None:
        self.slices = {name: slice_figures(name) for name in SLICES}
        self.state = State.STARTING
        self.realtime_factor = math.nan
        self.peers = [PeerStatus("iot2050")]
        self.shields = [ShieldStatus("shield")]
        self.domains = [Ros2Status("ros2")]
        self.input_ages_s: dict[str, float] = {}
        self.rejected: Counter[tuple[str, str]] = Counter()
        self.differing = 2
        self.end_to_end = Histogram125()
        self.gc_pause = Histogram125()
        self.model_gap: dict[str, float] = {}
        self.gap_alarms: dict[str, bool] = {}
        self.outputs: dict[str, float] = {}
        self.audit: dict[str, bool] = {}
        self.faults: dict[str, int] = {}
        self.tasks = 8
        self.observed = [observer.counted(np.zeros(N_HEAD))]
        self.recalibration: Figures | None = Figures()
        self.kept = Supervisor()
        self.n_reads = 0

    def sources(self) -> list[MetricSource[Any]]:
        return [
            MetricSource(scheduler.METRICS, self.pace),
            MetricSource(core.STATE_METRICS, lambda: self.state),
            MetricSource(core.PARAMETER_METRICS, lambda: self.differing),
            MetricSource(
                core.INPUT_METRICS,
                lambda: core.InputFigures(self.input_ages_s, self.rejected),
            ),
            MetricSource(peer_metrics.METRICS, lambda: self.peers),
            MetricSource(shield_metrics.METRICS, lambda: self.shields),
            MetricSource(ros2_metrics.METRICS, lambda: self.domains),
            MetricSource(daemon.LATENCY_METRICS, lambda: self.end_to_end),
            MetricSource(daemon.GAP_METRICS, lambda: self.model_gap),
            MetricSource(daemon.ALARM_METRICS, lambda: self.gap_alarms),
            MetricSource(daemon.OUTPUT_METRICS, lambda: self.outputs),
            MetricSource(faults.METRICS, lambda: self.faults),
            MetricSource(observer.METRICS, lambda: self.observed),
            *self.looks(),
            MetricSource(audit.METRICS, lambda: self.audit),
            MetricSource(daemon.TASK_METRICS, lambda: self.kept),
            MetricSource(daemon.PROGRAM_METRICS, self.program),
        ]

    def looks(self) -> list[MetricSource[Any]]:
        figures = self.recalibration
        return [MetricSource(RECALIBRATION_METRICS, lambda: figures)] if figures else []

    def pace(self) -> scheduler.PaceFigures:
        self.n_reads += 1
        return scheduler.PaceFigures(self.slices, self.realtime_factor, self.gc_pause)

    def program(self) -> daemon.Program:
        return daemon.Program("0123456789abcdef", self.tasks)

    def fill(self) -> None:
        """Set everything that a daemon in its default configuration can ever show."""
        self.shields, self.domains, self.observed, self.recalibration = [], [], [], None
        window = LatencyWindow(1000, 30e3, 9e3, 5e3, 80e3)
        self.slices = {
            name: slice_figures(name, window=window, margin_min_ns=900_000)
            for name in SLICES
        }
        self.state = State.RUNNING
        self.realtime_factor = 1.0
        peer = self.peers[0]
        peer.connected, peer.clock_offset_s = True, 0.002
        for kind in set(FaultKind) - OF_S7:
            peer.fault_counts[kind] = 1
        for source in ("opcua", "peer:iot2050"):
            self.input_ages_s[source] = 0.01
            for reason in reasons_of(source):
                self.rejected[source, reason] = 1
        self.outputs = dict.fromkeys(EXPORTED, 1.0)
        self.faults = {"injected": 1, "forced": 1}
        self.audit = {f"item_{number}": True for number in range(15)}

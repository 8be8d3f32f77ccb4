"""The table of all metrics: name, kind, labels, help and where the value comes from.

Names and labels are those of the specification. The reference page, the collector and the budget of
series are made from this table; a new metric is a new row.
"""

import math
import platform
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from hilserver import __version__
from hilserver.compiled.histogram import BOUNDS_NS
from hilserver.monitoring.metrics_sources import DurationCounts, MetricsSources, PeerFigures
from hilserver.monitoring.metrics_totals import Reading, counter
from hilserver.signals import State

US, MS, S = 10**3, 10**6, 10**9


class Kind(StrEnum):
    """Kinds of metrics, in Prometheus' words."""

    COUNTER = "counter"
    GAUGE = "gauge"
    HISTOGRAM = "histogram"


Row = tuple[tuple[str, ...], float | Reading]


@dataclass(frozen=True, slots=True)
class Metric:
    """One metric.

    Attributes
    ----------
    read : callable
        Yields (label values, value); a counter's or histogram's value is a `Reading`.
    range_ns : tuple of int
        Smallest and largest exported bucket bound [ns] of a histogram; both are 1-2-5 bounds.
        What lies outside is counted in the first bucket and in ``+Inf``.
    """

    name: str
    kind: Kind
    help: str
    labels: tuple[str, ...]
    read: Callable[[MetricsSources], Iterable[Row]]
    range_ns: tuple[int, int] = (0, 0)

    @property
    def bound_indices(self) -> range:
        """Indices into ``BOUNDS_NS`` of the exported bucket bounds."""
        low, high = (int(np.searchsorted(BOUNDS_NS, bound)) for bound in self.range_ns)
        return range(low, high + 1)


def _durations(histogram: DurationCounts) -> Reading:
    return Reading(histogram.counts.copy(), histogram.sum_ns)  # it is counted on in place


def _wake_latency(sources: MetricsSources) -> Iterator[Row]:
    for name, figures in sources.slices().items():
        yield (name,), Reading(figures.latency_counts, figures.latency_sum_ns)


def _execution(sources: MetricsSources) -> Iterator[Row]:
    for name, figures in sources.slices().items():
        if name in sources.executed_slices:
            yield (name,), Reading(figures.execution_counts, figures.execution_sum_ns)


def _wake_jitter(sources: MetricsSources) -> Iterator[Row]:
    for name, figures in sources.slices().items():
        deviation_ns = figures.window.deviation_ns
        if math.isfinite(deviation_ns):
            yield (name,), deviation_ns / S


def _margin_min(sources: MetricsSources) -> Iterator[Row]:
    for name, figures in sources.slices().items():
        if figures.margin_min_ns is not None:
            yield (name,), figures.margin_min_ns / S


def _overruns(sources: MetricsSources) -> Iterator[Row]:
    for name, figures in sources.slices().items():
        yield (name, "late_wake"), counter(figures.late_wakes)
        yield (name, "long_run"), counter(figures.long_runs)


def _missed_ticks(sources: MetricsSources) -> Iterator[Row]:
    for name, figures in sources.slices().items():
        yield (name,), counter(figures.missed_ticks)


def _realtime_factor(sources: MetricsSources) -> Iterator[Row]:
    factor = sources.realtime_factor()
    if math.isfinite(factor):
        yield (), factor


def _state(sources: MetricsSources) -> Iterator[Row]:
    now = sources.state()
    for state in State:
        yield (state.word,), float(state.word == now)


def _peer(figure: Callable[[PeerFigures], float | Reading | None]) -> Callable[..., Iterator[Row]]:
    """Return a reader of one figure of every peer; an unknown figure (None) is left out."""

    def read(sources: MetricsSources) -> Iterator[Row]:
        for peer in sources.peers():
            value = figure(peer)
            if value is not None:
                yield (peer.name,), value

    return read


def _peer_faults(sources: MetricsSources) -> Iterator[Row]:
    for peer in sources.peers():
        for kind, count in sorted(peer.fault_counts.items()):
            yield (peer.name, kind), counter(count)


def _input_age(sources: MetricsSources) -> Iterator[Row]:
    for source, age_s in sorted(sources.input_ages_s().items()):
        yield (source,), age_s


def _rejected(sources: MetricsSources) -> Iterator[Row]:
    for labels, count in sorted(sources.rejected().items()):
        yield labels, counter(count)


def _model_gap(sources: MetricsSources) -> Iterator[Row]:
    for channel, gap in sorted(sources.model_gap().items()):
        yield (channel,), gap


def _gap_alarms(sources: MetricsSources) -> Iterator[Row]:
    for channel, is_on in sorted(sources.gap_alarms().items()):
        yield (channel,), float(is_on)


def _faults(sources: MetricsSources) -> Iterator[Row]:
    for kind, number in sources.faults().items():
        yield (kind,), float(number)


def _audit(sources: MetricsSources) -> Iterator[Row]:
    for item, is_ok in sorted(sources.audit().items()):
        yield (item,), float(is_ok)


def _build_labels(sources: MetricsSources) -> tuple[str, ...]:
    return (__version__, platform.python_version(), sources.kernel_hash, sources.config_sha256())


METRICS: tuple[Metric, ...] = (
    Metric(
        "hil_wake_latency_seconds",
        Kind.HISTOGRAM,
        "Actual minus planned start of a slice.",
        ("slice",),
        _wake_latency,
        (5 * US, 100 * MS),
    ),
    Metric(
        "hil_execution_seconds",
        Kind.HISTOGRAM,
        "Work of a slice, measured before the wait for the next start.",
        ("slice",),
        _execution,
        (1 * US, 10 * MS),
    ),
    Metric(
        "hil_wake_jitter_seconds",
        Kind.GAUGE,
        "Standard deviation of the wake latency over the last window.",
        ("slice",),
        _wake_jitter,
    ),
    Metric(
        "hil_margin_min_seconds",
        Kind.GAUGE,
        "Smallest deadline minus end since the last reset of the statistics; positive is good.",
        ("slice",),
        _margin_min,
    ),
    Metric(
        "hil_overruns_total",
        Kind.COUNTER,
        "Ticks that ended after their deadline, by cause: late_wake or long_run.",
        ("slice", "cause"),
        _overruns,
    ),
    Metric(
        "hil_missed_ticks_total",
        Kind.COUNTER,
        "Planned starts that were skipped.",
        ("slice",),
        _missed_ticks,
    ),
    Metric(
        "hil_realtime_factor",
        Kind.GAUGE,
        "Simulated time over wall time, rolling; 1 is real time.",
        (),
        _realtime_factor,
    ),
    Metric(
        "hil_state",
        Kind.GAUGE,
        "1 for the state the daemon is in, 0 for the others.",
        ("state",),
        _state,
    ),
    Metric(
        "hil_peer_connected",
        Kind.GAUGE,
        "1 while a session with the peer exists and answers.",
        ("peer",),
        _peer(lambda peer: float(peer.connected)),
    ),
    Metric(
        "hil_peer_reconnects_total",
        Kind.COUNTER,
        "Sessions with the peer after the first one.",
        ("peer",),
        _peer(lambda peer: counter(peer.reconnects)),
    ),
    Metric(
        "hil_peer_round_trip_seconds",
        Kind.HISTOGRAM,
        "Heartbeat read of the peer's clock, request to answer.",
        ("peer",),
        _peer(lambda peer: _durations(peer.round_trip)),
        (100 * US, 1 * S),
    ),
    Metric(
        "hil_peer_one_way_latency_seconds",
        Kind.HISTOGRAM,
        "SourceTimestamp to arrival, corrected by the clock offset, only from stamps that advance.",
        ("peer",),
        _peer(lambda peer: _durations(peer.one_way)),
        (100 * US, 1 * S),
    ),
    Metric(
        "hil_peer_interval_seconds",
        Kind.HISTOGRAM,
        "Time between two arrivals of data from the peer.",
        ("peer",),
        _peer(lambda peer: _durations(peer.interval)),
        (1 * MS, 10 * S),
    ),
    Metric(
        "hil_peer_faults_total",
        Kind.COUNTER,
        "Lies and refusals of the peer by kind, such as NaN with status Good or dead time stamps.",
        ("peer", "kind"),
        _peer_faults,
    ),
    Metric(
        "hil_input_age_seconds",
        Kind.GAUGE,
        "Age of the newest accepted input of a source.",
        ("source",),
        _input_age,
    ),
    Metric(
        "hil_rejected_values_total",
        Kind.COUNTER,
        "Values refused before the process image, by source and reason.",
        ("source", "reason"),
        _rejected,
    ),
    Metric(
        "hil_end_to_end_seconds",
        Kind.HISTOGRAM,
        "Change of a set-point to the first published output that contains it.",
        (),
        lambda sources: [((), _durations(sources.end_to_end))],
        (500 * US, 5 * S),
    ),
    Metric(
        "hil_clock_offset_seconds",
        Kind.GAUGE,
        "Peer's clock minus ours.",
        ("peer",),
        _peer(lambda peer: peer.clock_offset_s),
    ),
    Metric(
        "hil_gc_pause_seconds",
        Kind.HISTOGRAM,
        "Pauses of the garbage collector.",
        (),
        lambda sources: [((), _durations(sources.gc_pause))],
        (10 * US, 500 * MS),
    ),
    Metric(
        "hil_model_gap",
        Kind.GAUGE,
        "Measured minus simulated value of a channel, in the channel's unit.",
        ("channel",),
        _model_gap,
    ),
    Metric(
        "hil_model_gap_alarm",
        Kind.GAUGE,
        "1 while the gap of a channel exceeds shadow.limits, else 0.",
        ("channel",),
        _gap_alarms,
    ),
    Metric(
        "hil_faults",
        Kind.GAUGE,
        "Faults at work and signals that are forced, by kind: injected or forced.",
        ("kind",),
        _faults,
    ),
    Metric(
        "hil_asyncio_tasks",
        Kind.GAUGE,
        "Tasks of the event loop that have not ended; without a change in clients it stays flat.",
        (),
        lambda sources: [((), float(sources.tasks()))],
    ),
    Metric(
        "hil_audit_ok",
        Kind.GAUGE,
        "1 where the system fulfils an item of the real-time audit.",
        ("item",),
        _audit,
    ),
    Metric(
        "hil_build_info",
        Kind.GAUGE,
        "Always 1; the labels name the running program, its kernels and its configuration.",
        ("version", "python", "kernel", "config"),
        lambda sources: [(_build_labels(sources), 1.0)],
    ),
)

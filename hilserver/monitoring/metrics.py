"""Prometheus exposition of the daemon's figures.

A custom collector turns the rows declared by every room into metric families at the moment of a
scrape. Histograms come from the int64 counts that kernels and links keep anyway: they cost the
paced path nothing extra, and there is no second set of histograms that could disagree.

    metrics = Metrics(Source(scheduler.METRICS, lambda: pace(scheduler)), ...)
    body, content_type = metrics.render()              # what /metrics answers
    with metrics.statistics_reset():                   # exported totals keep counting
        scheduler.statistics.reset()
"""

import math
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from prometheus_client import CollectorRegistry, PlatformCollector, ProcessCollector
from prometheus_client.exposition import choose_encoder
from prometheus_client.metrics_core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
)
from prometheus_client.metrics_core import Metric as Family
from prometheus_client.registry import Collector

from hilserver.compiled.histogram import BOUNDS_NS
from hilserver.metrics import Metric, MetricKind, MetricReading, MetricSource, Row

Counts = NDArray[np.int64]


@dataclass(slots=True)
class _Entry:
    last: MetricReading
    total: Counts
    total_sum_ns: int = 0


@dataclass(slots=True)
class LifetimeTotals:
    """Adds up the counts of every source between two readings; a lower count is a reset.

    A Prometheus counter that goes back looks like a restart of the program. ``ResetStatistics``
    clears the figures for people; exported ones keep counting::

        figure   3  5  5 |reset| 0  2  4
        total    3  5  5         5  7  9
    """

    _entries: dict[Hashable, _Entry] = field(default_factory=dict)

    def advance(self, key: Hashable, reading: MetricReading) -> MetricReading:
        """Add the newest `reading` of `key`; return its total since the process started."""
        entry = self._entry(key, reading)
        was_reset = bool((reading.counts < entry.last.counts).any())
        entry.total += (
            reading.counts if was_reset else reading.counts - entry.last.counts
        )
        entry.total_sum_ns += reading.sum_ns - (0 if was_reset else entry.last.sum_ns)
        entry.last = reading
        return MetricReading(entry.total.copy(), entry.total_sum_ns)

    def rebase(self, key: Hashable, reading: MetricReading) -> None:
        """Continue from `reading` without adding it: the source has just been reset."""
        self._entry(key, reading).last = reading

    def _entry(self, key: Hashable, reading: MetricReading) -> _Entry:
        if key not in self._entries:
            zeros = np.zeros_like(reading.counts)
            self._entries[key] = _Entry(last=MetricReading(zeros), total=zeros.copy())
        return self._entries[key]


_OPENMETRICS = "application/openmetrics-text; version=1.0.0"
_FAMILIES: dict[MetricKind, Any] = {
    MetricKind.COUNTER: CounterMetricFamily,
    MetricKind.GAUGE: GaugeMetricFamily,
    MetricKind.HISTOGRAM: HistogramMetricFamily,
}
_BOUNDS_TEXT = [str(bound_ns / 1e9) for bound_ns in BOUNDS_NS]


class Metrics:
    """Registry of one daemon: metrics of the rooms, and process metrics of the client library."""

    def __init__(self, *sources: MetricSource[Any]) -> None:
        self.registry = CollectorRegistry(auto_describe=False)
        self._collector = _HilCollector(sources)
        self.registry.register(self._collector)
        ProcessCollector(registry=self.registry)
        PlatformCollector(registry=self.registry)

    def render(self, is_openmetrics: bool = False) -> tuple[bytes, str]:
        """Return (body, content type) in Prometheus' text format or in OpenMetrics."""
        encode, content_type = choose_encoder(
            _OPENMETRICS if is_openmetrics else "text/plain"
        )
        return encode(self.registry), content_type

    @contextmanager
    def statistics_reset(self) -> Iterator[None]:
        """Enclose a reset of any source, so that no earlier count is lost."""
        for key, reading in self._collector.readings():
            self._collector.totals.advance(key, reading)
        yield
        for key, reading in self._collector.readings():
            self._collector.totals.rebase(key, reading)


_Key = tuple[str, tuple[str, ...]]


class _HilCollector(Collector):
    """Yields one family per metric."""

    def __init__(self, sources: tuple[MetricSource[Any], ...]) -> None:
        self.totals = LifetimeTotals()
        self._sources = sources

    def collect(self) -> Iterator[Family]:
        """Yield all families with their present values."""
        for metric, rows in self._read():
            family = _FAMILIES[metric.kind](
                metric.name, metric.help, labels=metric.labels
            )
            for labels, value in rows:
                if not isinstance(value, MetricReading):
                    family.add_metric(labels, value)
                    continue
                total = self.totals.advance((metric.name, labels), value)
                if metric.kind is MetricKind.COUNTER:
                    family.add_metric(labels, int(total.counts[0]))
                else:
                    # Upper bound [s] as text and cumulated count of each exported bucket.
                    cumulated = np.cumsum(total.counts).tolist()
                    exported = [
                        (_BOUNDS_TEXT[index], cumulated[index])
                        for index in metric.bound_indices
                    ]
                    buckets = [*exported, ("+Inf", cumulated[-1])]
                    family.add_metric(labels, buckets, total.sum_ns / 1e9)
            yield cast("Family", family)

    def readings(self) -> Iterator[tuple[_Key, MetricReading]]:
        """Yield the present reading of every counter and histogram."""
        for metric, rows in self._read():
            for labels, value in rows:
                if isinstance(value, MetricReading):
                    yield (metric.name, labels), value

    def _read(self) -> Iterator[tuple[Metric[Any], list[Row]]]:
        for source in self._sources:
            figures = source.figures()
            for metric in source.metrics:
                rows: list[Row] = []
                for labels, value in metric.read(figures):
                    if value is None:
                        continue
                    if isinstance(value, MetricReading) or math.isfinite(value):
                        rows.append((labels, value))
                yield metric, rows

"""Prometheus exposition of the daemon's figures.

A custom collector turns the int64 counts that kernels and links keep anyway into metric families at
the moment of a scrape: counting costs the paced path nothing more, and no second set of histograms
exists that could disagree with the first.

    metrics = Metrics(MetricsSources(slices=..., state=..., realtime_factor=...))
    body, content_type = metrics.render()              # what /metrics answers
    with metrics.statistics_reset():                   # exported totals keep counting
        scheduler.statistics.reset()
"""

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, cast

import numpy as np
from prometheus_client import CollectorRegistry, GCCollector, PlatformCollector, ProcessCollector
from prometheus_client.exposition import choose_encoder
from prometheus_client.metrics_core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
)
from prometheus_client.metrics_core import Metric as Family
from prometheus_client.registry import Collector

from hilserver.compiled.histogram import BOUNDS_NS
from hilserver.monitoring.metrics_sources import MetricsSources
from hilserver.monitoring.metrics_table import METRICS, Kind, Metric
from hilserver.monitoring.metrics_totals import Counts, LifetimeTotals, Reading

__all__ = ["Metrics", "MetricsSources"]

_OPENMETRICS = "application/openmetrics-text; version=1.0.0"
_FAMILIES: dict[Kind, Any] = {
    Kind.COUNTER: CounterMetricFamily,
    Kind.GAUGE: GaugeMetricFamily,
    Kind.HISTOGRAM: HistogramMetricFamily,
}
_BOUNDS_TEXT = [str(bound_ns / 1e9) for bound_ns in BOUNDS_NS]


class Metrics:
    """The registry of one daemon: its own metrics and the client library's process metrics."""

    def __init__(self, sources: MetricsSources) -> None:
        self.registry = CollectorRegistry(auto_describe=False)
        self._collector = _HilCollector(sources)
        self.registry.register(self._collector)
        ProcessCollector(registry=self.registry)
        PlatformCollector(registry=self.registry)
        GCCollector(registry=self.registry)

    def render(self, is_openmetrics: bool = False) -> tuple[bytes, str]:
        """Return (body, content type) in Prometheus' text format or in OpenMetrics."""
        encode, content_type = choose_encoder(_OPENMETRICS if is_openmetrics else "text/plain")
        return encode(self.registry), content_type

    @contextmanager
    def statistics_reset(self) -> Iterator[None]:
        """Surround a reset of any source, so that nothing counted before it is lost."""
        self._collector.read(self._collector.totals.advance)
        yield
        self._collector.read(self._collector.totals.rebase)


class _HilCollector(Collector):
    """Yields one family per row of the table of metrics."""

    def __init__(self, sources: MetricsSources) -> None:
        self.totals = LifetimeTotals()
        self._sources = sources

    def collect(self) -> Iterator[Family]:
        """Yield all families with their present values."""
        sources = self._sources_of_one_scrape()
        for metric in METRICS:
            yield self._family(metric, sources)

    def read(self, take: Callable[[object, Reading], object]) -> None:
        """Hand the present reading of every counter and histogram to `take`."""
        sources = self._sources_of_one_scrape()
        for metric in METRICS:
            for labels, value in metric.read(sources):
                if isinstance(value, Reading):
                    take((metric.name, labels), value)

    def _sources_of_one_scrape(self) -> MetricsSources:
        # Six metrics read the slices: asked once, all six show the same instant.
        slices = self._sources.slices()
        return dataclasses.replace(self._sources, slices=lambda: slices)

    def _family(self, metric: Metric, sources: MetricsSources) -> Family:
        family = _FAMILIES[metric.kind](metric.name, metric.help, labels=metric.labels)
        for labels, value in metric.read(sources):
            if not isinstance(value, Reading):
                family.add_metric(labels, value)
                continue
            total = self.totals.advance((metric.name, labels), value)
            if metric.kind is Kind.COUNTER:
                family.add_metric(labels, int(total.counts[0]))
            else:
                family.add_metric(labels, _buckets(metric, total.counts), total.sum_ns / 1e9)
        return cast("Family", family)


def _buckets(metric: Metric, counts: Counts) -> list[tuple[str, float]]:
    """Return (upper bound [s] as text, cumulated count) of the exported buckets and ``+Inf``."""
    cumulated = np.cumsum(counts).tolist()
    exported = [(_BOUNDS_TEXT[index], cumulated[index]) for index in metric.bound_indices]
    return [*exported, ("+Inf", cumulated[-1])]

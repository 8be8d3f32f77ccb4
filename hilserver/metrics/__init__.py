"""What a metric is: name, help, labels, and the function that reads it.

Every room declares its own metrics as plain rows beside the code that feeds them. No client library
is used here: `hilserver.monitoring` turns the rows into what Prometheus reads.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from hilserver.compiled.histogram import BOUNDS_NS, Histogram125

US: Final = 10**3
MS: Final = 10**6
S: Final = 10**9

Figures = TypeVar("Figures")


class MetricKind(StrEnum):
    """Kinds of metrics, as Prometheus names them."""

    COUNTER = "counter"
    GAUGE = "gauge"
    HISTOGRAM = "histogram"


@dataclass(frozen=True, slots=True)
class MetricReading:
    """The present reading of a counter or a histogram."""

    # one count for a counter, one per bucket for a histogram; falls only when it is reset
    counts: NDArray[np.int64]
    sum_ns: int = 0  # sum of the counted durations [ns]; 0 for a counter


Row = tuple[tuple[str, ...], float | MetricReading | None]
"""Label values and the value; None while it is unknown."""


@dataclass(frozen=True, slots=True)
class Metric(Generic[Figures]):
    """One metric."""

    # ends in its unit, counters in ``_total``. A metric never changes its meaning
    name: str
    help: str
    labels: tuple[str, ...]
    # yields rows from the figures of its source; a counter's or histogram's value is a `Reading`.
    # Values of None or NaN are left out
    read: Callable[[Figures], Iterable[Row]]
    # smallest and largest exported bucket bound [ns] of a histogram, both 1-2-5 bounds. Values
    # outside are counted in the first bucket and in ``+Inf``
    range_ns: tuple[int, int] = (0, 0)

    @property
    def kind(self) -> MetricKind:
        """Kind in Prometheus: a histogram has a range, the name of a counter ends in ``_total``."""
        if any(self.range_ns):
            return MetricKind.HISTOGRAM
        return MetricKind.COUNTER if self.name.endswith("_total") else MetricKind.GAUGE

    @property
    def bound_indices(self) -> range:
        """Indices into ``BOUNDS_NS`` of the exported bucket bounds."""
        low, high = (int(np.searchsorted(BOUNDS_NS, bound)) for bound in self.range_ns)
        return range(low, high + 1)


@dataclass(frozen=True, slots=True)
class MetricSource(Generic[Figures]):
    """Metrics and the figures they are read from."""

    metrics: Sequence[Metric[Figures]]
    # called once per scrape, on the event loop, so that all metrics of a source are of the same
    # instant; must not wait
    figures: Callable[[], Figures]


def counter(value: int) -> MetricReading:
    """Return the reading of a plain counter."""
    return MetricReading(np.array([value], dtype=np.int64))


def durations(histogram: Histogram125) -> MetricReading:
    """Return the reading of a histogram; a copy, as counting continues in place."""
    return MetricReading(histogram.counts.copy(), histogram.sum_ns)


def by_name(figures: Mapping[str, float]) -> Iterator[Row]:
    """Yield a row for every entry of a table of numbers, labelled with its key."""
    for name, value in sorted(figures.items()):
        yield (name,), float(value)


def gauges(
    name: str, about: str, label: str
) -> tuple[Metric[Mapping[str, float]], ...]:
    """Return a metric table with one gauge that has a row for every entry of a table of numbers."""
    return (Metric(name, about, (label,), by_name),)

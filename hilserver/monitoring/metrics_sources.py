"""What the metrics are made from: plain figures and callables that the daemon hands in.

Nothing here knows a socket, a scheduler or a peer. Every callable is called once per scrape, on the
event loop; it returns at once what it has.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hilserver.compiled.histogram import Histogram125


class DurationCounts(Protocol):
    """The part of `Histogram125` that is exported."""

    @property
    def counts(self) -> NDArray[np.int64]:
        """Count per bucket, shape (N_BUCKETS,), not cumulated."""

    @property
    def sum_ns(self) -> int:
        """Sum of all durations [ns]."""


class WakeWindow(Protocol):
    """The last complete window of wake latencies."""

    @property
    def deviation_ns(self) -> float:
        """Standard deviation [ns]; NaN while there is no complete window."""


class SliceFigures(Protocol):
    """Figures of one slice since the last reset of the statistics."""

    @property
    def latency_counts(self) -> NDArray[np.int64]:
        """Wake latency, count per bucket, shape (N_BUCKETS,)."""

    @property
    def latency_sum_ns(self) -> int:
        """Sum of the wake latencies [ns]."""

    @property
    def execution_counts(self) -> NDArray[np.int64]:
        """Execution time, count per bucket, shape (N_BUCKETS,)."""

    @property
    def execution_sum_ns(self) -> int:
        """Sum of the execution times [ns]."""

    @property
    def window(self) -> WakeWindow:
        """Wake latency over the last complete window."""

    @property
    def margin_min_ns(self) -> int | None:
        """Smallest deadline minus end [ns]; None before the first run."""

    @property
    def late_wakes(self) -> int:
        """Overruns because the slice was woken late."""

    @property
    def long_runs(self) -> int:
        """Overruns because the slice ran long."""

    @property
    def missed_ticks(self) -> int:
        """Planned starts that were skipped."""


class PeerFigures(Protocol):
    """Figures of the link to one OPC UA peer."""

    @property
    def name(self) -> str:
        """As configured."""

    @property
    def connected(self) -> bool:
        """A session exists and answers."""

    @property
    def reconnects(self) -> int:
        """Sessions after the first one."""

    @property
    def round_trip(self) -> DurationCounts:
        """Heartbeat, request to answer."""

    @property
    def one_way(self) -> DurationCounts:
        """SourceTimestamp to arrival, only from stamps that advance."""

    @property
    def interval(self) -> DurationCounts:
        """Between two arrivals of data."""

    @property
    def clock_offset_s(self) -> float | None:
        """Peer's clock minus ours [s]; None while unknown."""

    @property
    def fault_counts(self) -> Mapping[str, int]:
        """Kind of fault -> how often it was seen."""


@dataclass(frozen=True, kw_only=True)
class MetricsSources:
    """Everything a scrape reads. What a daemon does not have keeps its default and exports nothing.

    Attributes
    ----------
    slices : callable
        Name of the slice -> its figures, in the order of the configuration.
    state : callable
        Word of a `State`: ``running`` and so on.
    realtime_factor : callable
        Simulated time over wall time, rolling; NaN while unknown.
    executed_slices : tuple of str
        Slices whose execution time is exported as a histogram (the budget of series allows two).
    peers : callable
        One `PeerFigures` for every configured peer, connected or not.
    input_ages_s : callable
        Source -> age [s] of its newest accepted write; a source never heard is left out.
    rejected : callable
        (source, reason) -> count of refused values.
    end_to_end, gc_pause : DurationCounts
        Set-point change to the first published output that contains it; pauses of the collector.
    model_gap : callable
        Channel -> measured minus simulated, in the unit of the channel.
    gap_alarms : callable
        Channel with a limit in the configuration -> its gap exceeds it.
    audit : callable
        Item of the real-time audit -> fulfilled.
    faults : callable
        Kind (injected, forced) -> number of those at work.
    tasks : callable
        Number of asyncio tasks that have not ended.
    kernel_hash : str
    config_sha256 : callable
        What runs: labels of ``hil_build_info``.
    """

    slices: Callable[[], Mapping[str, SliceFigures]]
    state: Callable[[], str]
    realtime_factor: Callable[[], float]
    executed_slices: tuple[str, ...] = ("plant", "publish")
    peers: Callable[[], Iterable[PeerFigures]] = tuple
    input_ages_s: Callable[[], Mapping[str, float]] = dict
    rejected: Callable[[], Mapping[tuple[str, str], int]] = dict
    end_to_end: DurationCounts = field(default_factory=Histogram125)
    gc_pause: DurationCounts = field(default_factory=Histogram125)
    model_gap: Callable[[], Mapping[str, float]] = dict
    gap_alarms: Callable[[], Mapping[str, bool]] = dict
    audit: Callable[[], Mapping[str, bool]] = dict
    faults: Callable[[], Mapping[str, int]] = dict
    tasks: Callable[[], int] = lambda: 0
    kernel_hash: str = ""
    config_sha256: Callable[[], str] = str

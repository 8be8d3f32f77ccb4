"""Metrics of the scheduler: figures of every slice, and pauses of the garbage collector."""

from collections.abc import Callable, Iterator, Mapping
from typing import Final, NamedTuple

from hilserver.compiled.histogram import Histogram125
from hilserver.metrics import MS, US, Metric, MetricReading, Row, S, counter, durations
from hilserver.scheduler.scheduler import Scheduler
from hilserver.scheduler.statistics import SliceFigures

EXECUTED_SLICES: Final = ("plant", "publish")
"""Slices whose execution time is exported; the budget of series allows two histograms."""


class PaceFigures(NamedTuple):
    """The figures that the metrics are read from."""

    slices: Mapping[str, SliceFigures]  # by name, in the order of the scheduler
    realtime_factor: float  # NaN while unknown
    gc_pauses: Histogram125


def pace(scheduler: Scheduler) -> PaceFigures:
    """Return the figures of a scheduler at this moment."""
    return PaceFigures(
        slices_by_name(scheduler),
        scheduler.statistics.tick.real_time_factor,
        scheduler.gc_pauses.pauses,
    )


def slices_by_name(scheduler: Scheduler) -> dict[str, SliceFigures]:
    """Return the figures of every slice, in the order of the scheduler."""
    return {
        name: scheduler.statistics.slice(name) for name in scheduler.statistics.names
    }


def _each(
    figure: Callable[[SliceFigures], float | MetricReading | None],
) -> Callable[[PaceFigures], Iterator[Row]]:
    """Return a reader of one figure of every slice."""
    return lambda now: (((name,), figure(f)) for name, f in now.slices.items())


def _execution(now: PaceFigures) -> Iterator[Row]:
    for name, f in now.slices.items():
        if name in EXECUTED_SLICES:
            yield (name,), MetricReading(f.execution_counts, f.execution_sum_ns)


def _margin_s(f: SliceFigures) -> float | None:
    return None if f.margin_min_ns is None else f.margin_min_ns / S


def _overruns(now: PaceFigures) -> Iterator[Row]:
    for name, f in now.slices.items():
        yield (name, "late_wake"), counter(f.late_wakes)
        yield (name, "long_run"), counter(f.long_runs)


METRICS: Final[tuple[Metric[PaceFigures], ...]] = (
    Metric(
        "hil_wake_latency_seconds",
        "Actual minus planned start of a slice.",
        ("slice",),
        _each(lambda f: MetricReading(f.latency_counts, f.latency_sum_ns)),
        (5 * US, 100 * MS),
    ),
    Metric(
        "hil_execution_seconds",
        "Work of a slice, measured before the wait for the next start.",
        ("slice",),
        _execution,
        (1 * US, 10 * MS),
    ),
    Metric(
        "hil_wake_jitter_seconds",
        "Standard deviation of the wake latency over the last window.",
        ("slice",),
        _each(lambda f: f.window.deviation_ns / S),
    ),
    Metric(
        "hil_margin_min_seconds",
        "Smallest deadline minus end since the last reset of the statistics; positive is good.",
        ("slice",),
        _each(_margin_s),
    ),
    Metric(
        "hil_overruns_total",
        "Ticks that ended after their deadline, by cause: late_wake or long_run.",
        ("slice", "cause"),
        _overruns,
    ),
    Metric(
        "hil_missed_ticks_total",
        "Planned starts that were skipped.",
        ("slice",),
        _each(lambda f: counter(f.missed_ticks)),
    ),
    Metric(
        "hil_realtime_factor",
        "Simulated time over wall time, rolling; 1 is real time.",
        (),
        lambda now: [((), now.realtime_factor)],
    ),
    Metric(
        "hil_gc_pause_seconds",
        "Pauses of the garbage collector.",
        (),
        lambda now: [((), durations(now.gc_pauses))],
        (10 * US, 500 * MS),
    ),
)

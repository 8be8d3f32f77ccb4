"""Metrics that only a shield has; the others are among those of peers, as peer ``shield``."""

from collections.abc import Collection, Iterator
from typing import Final

from hilserver.compiled.histogram import N_BUCKETS
from hilserver.io.shield import words as w
from hilserver.io.shield.status import ShieldStatus
from hilserver.metrics import MS, US, Metric, MetricReading, Row, counter

Shields = Collection[ShieldStatus]  # one, or none if the shield is not enabled


def _requests(shields: Shields) -> Iterator[Row]:
    for shield in shields:
        for name, count in sorted(shield.requests.items()):
            yield (name,), counter(count)


def _lateness(shields: Shields) -> Iterator[Row]:
    for shield in shields:
        counts = shield.words[w.LATE_COUNTS : w.LATE_COUNTS + N_BUCKETS].copy()
        yield (), MetricReading(counts, shield.count(w.LATE_SUM))


METRICS: Final[tuple[Metric[Shields], ...]] = (
    Metric(
        "hil_shield_requests_total",
        "Requests of the host on the serial line, by command.",
        ("command",),
        _requests,
    ),
    Metric(
        "hil_shield_lateness_seconds",
        "How much later than the line permits a response is written.",
        (),
        _lateness,
        (10 * US, 100 * MS),
    ),
)

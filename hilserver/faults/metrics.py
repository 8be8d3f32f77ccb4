"""Metrics of injected faults and forced signals, read from `Faults.counts`."""

from collections.abc import Mapping
from typing import Final

from hilserver.metrics import Metric, by_name

METRICS: Final[tuple[Metric[Mapping[str, float]], ...]] = (
    Metric(
        "hil_faults",
        "Faults at work and signals that are forced, by kind: injected or forced.",
        ("kind",),
        by_name,
    ),
)

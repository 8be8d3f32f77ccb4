"""Metrics of injected faults and forced signals, read from `Faults.counts`."""

from typing import Final

from hilserver.metrics import gauges

METRICS: Final = gauges(
    "hil_faults",
    "Active faults and forced signals, by kind: injected or forced.",
    "kind",
)

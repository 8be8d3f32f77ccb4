"""Metrics of injected faults and forced signals, read from `Faults.counts`."""

from typing import Final

from hilserver.metrics import gauges

METRICS: Final = gauges(
    "hil_faults", "Faults at work and signals that are forced, by kind: injected or forced.", "kind"
)

"""What a metric is. Every room declares its own as plain rows beside the code that feeds them.

Nothing here knows a client library: `hilserver.monitoring` turns rows into what Prometheus reads.
"""

from hilserver.metrics.metric import (
    MS,
    US,
    Kind,
    Metric,
    Reading,
    Row,
    S,
    Source,
    by_name,
    counter,
    durations,
)

__all__ = [
    "MS",
    "US",
    "Kind",
    "Metric",
    "Reading",
    "Row",
    "S",
    "Source",
    "by_name",
    "counter",
    "durations",
]

"""All metrics: those of the rooms and of the daemon itself.

A new metric is a row in the table of the room that feeds it; only a new table is added here and in
`connections`.
"""

import platform
from typing import Any, Final, NamedTuple

from hilserver import __version__
from hilserver.compiled import kernel_hash
from hilserver.compiled.histogram import Histogram125
from hilserver.core import metrics as core
from hilserver.core.recalibration import RECALIBRATION_METRICS
from hilserver.faults import metrics as faults
from hilserver.io.peer_link import metrics as peer_metrics
from hilserver.io.ros2 import metrics as ros2_metrics
from hilserver.io.shield import metrics as shield_metrics
from hilserver.metrics import US, Metric, S, by_name, counter, durations, gauges
from hilserver.monitoring import audit
from hilserver.observer import metrics as observer
from hilserver.scheduler import metrics as scheduler
from hilserver.tasks import Supervisor


class Program(NamedTuple):
    """What runs: hash of the configuration, and asyncio tasks that have not ended."""

    config: str
    tasks: int


LATENCY_METRICS: Final[tuple[Metric[Histogram125], ...]] = (
    Metric(
        "hil_end_to_end_seconds",
        "Time from a set-point change to the first published output that contains it.",
        (),
        lambda end_to_end: [((), durations(end_to_end))],
        (500 * US, 5 * S),
    ),
)

GAP_METRICS: Final = gauges(
    "hil_model_gap",
    "Measured minus simulated value of a channel, in the channel's unit.",
    "channel",
)

ALARM_METRICS: Final = gauges(
    "hil_model_gap_alarm",
    "1 while the gap of a channel exceeds shadow.limits, else 0.",
    "channel",
)

OUTPUT_METRICS: Final = gauges(
    "hil_output",
    "Newest pose, wheel speeds and gap of the body; names end in the unit.",
    "signal",
)

TASK_METRICS: Final[tuple[Metric[Supervisor], ...]] = (
    Metric(
        "hil_task_up",
        "1 while a task that should last runs, 0 while it waits to begin again or hangs.",
        ("task",),
        lambda tasks: by_name(tasks.up()),
    ),
    Metric(
        "hil_task_restarts_total",
        "Ends of a task that should last, whatever ended it; it began again each time.",
        ("task",),
        lambda tasks: (((n,), counter(c)) for n, c in sorted(tasks.restarts.items())),
    ),
    Metric(
        "hil_task_failures_total",
        "Tasks that end by themselves and failed instead, such as the answer to one request.",
        ("task",),
        lambda tasks: (((n,), counter(c)) for n, c in sorted(tasks.failures.items())),
    ),
)

PROGRAM_METRICS: Final[tuple[Metric[Program], ...]] = (
    Metric(
        "hil_asyncio_tasks",
        "Unfinished tasks of the event loop; constant while the number of clients is.",
        (),
        lambda now: [((), float(now.tasks))],
    ),
    Metric(
        "hil_build_info",
        "Always 1; the labels name the running program, its kernels and its configuration.",
        ("version", "python", "kernel", "config"),
        lambda now: [(_build(now.config), 1.0)],
    ),
)


def _build(config: str) -> tuple[str, ...]:
    return __version__, platform.python_version(), kernel_hash(), config


METRICS: Final[tuple[Metric[Any], ...]] = (
    *scheduler.METRICS,
    *core.STATE_METRICS,
    *core.PARAMETER_METRICS,
    *core.INPUT_METRICS,
    *RECALIBRATION_METRICS,
    *peer_metrics.METRICS,
    *shield_metrics.METRICS,
    *ros2_metrics.METRICS,
    *LATENCY_METRICS,
    *GAP_METRICS,
    *ALARM_METRICS,
    *OUTPUT_METRICS,
    *faults.METRICS,
    *observer.METRICS,
    *audit.METRICS,
    *TASK_METRICS,
    *PROGRAM_METRICS,
)
"""In the order of the reference page."""

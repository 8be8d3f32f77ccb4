"""Metrics of the observer, read from the numbers of its filter."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilserver.metrics import Metric, counter
from hilserver.observer.layout import N_HEAD, Head

SAMPLES: Final = ("accepted", "rejected", "late")


def counted(numbers: NDArray[np.float64]) -> Head:
    """Return the counters of a filter, from its numbers."""
    return Head.of(numbers[:N_HEAD].copy())


METRICS: Final[tuple[Metric[Sequence[Head]], ...]] = (
    Metric(
        "hil_observer_samples_total",
        "Navigation samples: accepted, rejected as outliers, or too late to be used.",
        ("outcome",),
        lambda all_: [
            ((name,), counter(int(one[name]))) for one in all_ for name in SAMPLES
        ],
    ),
    Metric(
        "hil_observer_readmitted_total",
        "Number of times that the robot was found away from where the observer had placed it.",
        (),
        lambda all_: [((), counter(int(one.readmitted))) for one in all_],
    ),
)

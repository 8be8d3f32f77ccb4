"""Metrics of the observer, read from the numbers of its filter."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilserver.metrics import Metric, counter
from hilserver.observer.layout import N_HEAD, Head

_SAMPLES: Final = ("accepted", "rejected", "late")


class Counted(NamedTuple):
    """What the filter has counted."""

    samples: dict[str, int]
    readmitted: int
    restarts: int


def counted(numbers: NDArray[np.float64]) -> Counted:
    """Return the counters of a filter from its numbers."""
    head = Head.of(numbers[:N_HEAD].copy())
    samples = {name: int(head[name]) for name in _SAMPLES}
    return Counted(samples, int(head.readmitted), int(head.restarts))


METRICS: Final[tuple[Metric[Sequence[Counted]], ...]] = (
    Metric(
        "hil_observer_samples_total",
        "Samples of the navigation: accepted, rejected as outliers, or too late to be taken in.",
        ("outcome",),
        lambda all_: [((name,), counter(n)) for one in all_ for name, n in one.samples.items()],
    ),
    Metric(
        "hil_observer_readmitted_total",
        "Times that the robot was found elsewhere than the observer had it.",
        (),
        lambda all_: [((), counter(one.readmitted)) for one in all_],
    ),
)

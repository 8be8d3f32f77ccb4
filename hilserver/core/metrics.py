"""Metrics of what the daemon does with its state and its inputs."""

from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

from hilserver.core.inputs import InputGate
from hilserver.metrics import Metric, Row, by_name, counter
from hilserver.signals import State


class InputFigures(NamedTuple):
    """What came in: age of every source's newest accepted write [s], and refusals.

    `rejected` counts by (source, reason).
    """

    ages_s: Mapping[str, float]
    rejected: Mapping[tuple[str, str], int]


def inputs(gate: InputGate) -> InputFigures:
    """Return the present figures of the gate; a source that has sent nothing is left out."""
    ages = {source: gate.age_s(source) for source in gate.sources}
    known = {source: age_s for source, age_s in ages.items() if age_s is not None}
    return InputFigures(known, gate.rejected)


def _states(now: State) -> Iterator[Row]:
    for state in State:
        yield (state.word,), float(state is now)


STATE_METRICS: Final[tuple[Metric[State], ...]] = (
    Metric(
        "hil_state",
        "1 for the state the daemon is in, 0 for the others.",
        ("state",),
        _states,
    ),
)

PARAMETER_METRICS: Final[tuple[Metric[int], ...]] = (
    Metric(
        "hil_parameters_changed",
        "Parameters that differ from the configuration.",
        (),
        lambda now: [((), float(now))],
    ),
)

INPUT_METRICS: Final[tuple[Metric[InputFigures], ...]] = (
    Metric(
        "hil_input_age_seconds",
        "Age of the newest accepted input of a source.",
        ("source",),
        lambda now: by_name(now.ages_s),
    ),
    Metric(
        "hil_rejected_values_total",
        "Values refused before they reached the process image, by source and reason.",
        ("source", "reason"),
        lambda now: (
            (labels, counter(count)) for labels, count in sorted(now.rejected.items())
        ),
    ),
)

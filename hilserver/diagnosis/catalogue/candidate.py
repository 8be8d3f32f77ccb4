"""A candidate: one direction in which the plant can change, and the usual ways to make one."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal, get_args

from hilserver.diagnosis.catalogue.traits import traits_of

Theta = Sequence[float]
Region = tuple[float, float, float, float]
StageName = Literal["drive", "pose"]
# in the order in which they are judged
STAGES: Final[tuple[StageName, ...]] = get_args(StageName)

LARGEST_WAVE = 0.5


@dataclass(frozen=True)
class Candidate:
    """One direction, or a few together, in which the plant can change."""

    cause: str  # public name
    label: str  # unique name of this candidate
    stage: StageName  # which residuals judge it
    start: tuple[float, ...]  # values of the parameters from which a fit starts
    null: tuple[float, ...]  # values at which it has no effect
    step: tuple[float, ...]  # physical steps of the finite differences
    # from values to terms of the plant (and ``shift.*``)
    terms: Callable[[Theta], dict[str, float]]
    # what is physically possible
    low: tuple[float, ...]
    high: tuple[float, ...]
    least: float  # size (largest parameter) below which it is not worth a name
    # whether the effect is nearly linear, so that the screen may extrapolate
    linear: bool = True
    # parameters of its shape that were searched, besides the fitted ones
    hidden: int = 0
    tried: tuple[float, ...] = ()  # more start values, for when much is left to explain
    # from a shift of its shape (an edge [m], the logarithm of a speed) to the candidate with that
    # shape, for a finer search
    moved: "Callable[[float], Candidate] | None" = None
    # standard deviation about null in sound machines; infinite: any size is usual
    prior: float = math.inf
    # terms of its shape that these data leave open, with their possible range
    undecided: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    # part of the floor where it acts: x_min, x_max, y_min, y_max [m]
    region: Region | None = None

    @property
    def weight(self) -> int:
        """Number of parameters that it costs, fitted and hidden."""
        return self.n + self.hidden

    @property
    def n(self) -> int:
        """Number of parameters."""
        return len(self.start)

    @property
    def is_limit(self) -> bool:
        """Whether its effect decreases as its value grows, and vanishes at infinity."""
        return traits_of(self.cause).is_limit

    @property
    def beginning(self) -> tuple[float, ...]:
        """Where a fit starts: the start value, or just off null."""
        if not self.linear:
            return self.start
        return tuple(n + 1e-3 * s for n, s in zip(self.null, self.step, strict=True))


def single(
    name: str,
    stage: StageName,
    step: float,
    least: float,
    low: float = -math.inf,
    high: float = math.inf,
) -> Candidate:
    """Return the candidate of one term whose effect is nearly linear."""
    cause = name.partition(".")[0]
    return several(cause, name, stage, (name,), (step,), least, low=low, high=high)


def start_grid(
    made: Candidate, null: float, values: Sequence[float]
) -> list[Candidate]:
    """Return one candidate per start value of a parameter whose effect is not linear."""
    return [
        replace(
            made,
            label=f"{made.label}@{value:g}",
            start=(value,),
            null=(null,),
            linear=False,
        )
        for value in values
    ]


def several(
    cause: str,
    label: str,
    stage: StageName,
    names: Sequence[str],
    step: Sequence[float],
    least: float,
    fixed: Mapping[str, float] | None = None,
    low: float = -math.inf,
    high: float = math.inf,
) -> Candidate:
    """Return a candidate of several terms that are fitted together, with others held fixed."""
    held = dict(fixed or {})

    def terms(theta: Theta) -> dict[str, float]:
        return {**dict(zip(names, map(float, theta), strict=True)), **held}

    n = len(names)
    zero = (0.0,) * n
    return Candidate(
        cause,
        label,
        stage,
        zero,
        zero,
        tuple(step),
        terms,
        (low,) * n,
        (high,) * n,
        least,
    )


def wave(cause: str, label: str, amplitude: str, phase: str, step: float) -> Candidate:
    """Return the candidate of an amplitude and a phase, fitted as cosine and sine parts."""

    def terms(theta: Theta) -> dict[str, float]:
        # each part may be that large
        size = min(math.hypot(theta[0], theta[1]), LARGEST_WAVE)
        return {
            amplitude: size,
            phase: math.atan2(theta[1], theta[0]) if size > 0.0 else 0.0,
        }

    zero, far = (0.0, 0.0), (LARGEST_WAVE, LARGEST_WAVE)
    low = (-LARGEST_WAVE, -LARGEST_WAVE)
    return Candidate(
        cause, label, "pose", zero, zero, (step, step), terms, low, far, 5 * step
    )

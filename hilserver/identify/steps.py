"""Steps in a log: where an input jumps and holds, and how a wheel answers."""

from dataclasses import dataclass

import numpy as np

from hilserver.arrays import Array
from hilserver.measured.data import MeasuredLog

_HOLD_S = 0.15
_BEFORE_S = 0.1
_LONGEST_S = 2.0
_SAMPLES_MIN = 6
_SMALLEST_SHARE = 0.05


@dataclass(frozen=True)
class Step:
    """One step of an input and the answer."""

    t_s: Array  # shape (n,); since the step; the samples before it are negative
    speed_rpm: Array  # shape (n,)
    size: float  # of the input, in its unit
    span: int
    at_s: float  # stamp of the step in its span


def find_steps(log: MeasuredLog, wheel: str, quantity: str) -> list[Step]:
    """Return the steps of ``wheel.{wheel}.{quantity}`` that hold before and after.

    The input that stands in a row holds from there on; the instant of a step is known to the
    distance of two rows.
    """
    found: list[Step] = []
    source, speed = log[f"wheel.{wheel}.{quantity}"], log[f"wheel.{wheel}.speed_rpm"]
    largest = float(np.max(np.abs(source.values), initial=0.0))
    for span in range(len(log.spans)):
        t_s, values = source.of(span)
        seen_s, seen = speed.of(span)
        if len(t_s) < 2 or len(seen_s) < _SAMPLES_MIN:
            continue
        changes = np.flatnonzero(np.diff(values) != 0.0) + 1
        edges = np.concatenate(([0], changes, [len(t_s)]))
        for i, change in enumerate(changes):
            size = float(values[change] - values[change - 1])
            since_s, at_s = t_s[edges[i]], float(t_s[change])
            until_s = t_s[edges[i + 2]] if edges[i + 2] < len(t_s) else seen_s[-1] + 1e-9
            held = at_s - since_s >= _BEFORE_S and until_s - at_s >= _HOLD_S
            if not held or abs(size) < _SMALLEST_SHARE * largest:
                continue
            begin_s = max(since_s + 0.8 * (at_s - since_s), at_s - _BEFORE_S)
            end_s = min(until_s, at_s + _LONGEST_S)
            rows = (seen_s >= begin_s) & (seen_s < end_s)
            before, after = (seen_s[rows] < at_s).sum(), (seen_s[rows] >= at_s).sum()
            if before >= 1 and after >= _SAMPLES_MIN:
                found.append(Step(seen_s[rows] - at_s, seen[rows], size, span, at_s))
    return found


def averaged(steps: list[Step]) -> tuple[Array, Array]:
    """Return the mean response per unit of the input on a grid, from the step on.

    Each answer begins at its own mean before the step; longer ones end with the shortest.
    """
    grid_s = float(np.median([np.median(np.diff(step.t_s)) for step in steps]))
    length_s = float(np.median([step.t_s[-1] for step in steps]))
    t_s = np.arange(0.0, length_s, grid_s)
    total, count = np.zeros(len(t_s)), np.zeros(len(t_s))
    for step in steps:
        start = float(np.mean(step.speed_rpm[step.t_s < 0.0]))
        inside = t_s <= step.t_s[-1]
        answer = np.interp(t_s, step.t_s, (step.speed_rpm - start) / step.size)
        total += np.where(inside, answer, 0.0)
        count += inside
    return t_s, total / np.maximum(count, 1.0)

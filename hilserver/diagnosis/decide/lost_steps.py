"""Set-points that came late or never: the trace of a link that loses messages."""

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.checks.support import SPAN_S, row_period_s
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.thresholds import (
    HALF,
    LARGE_STEP_RPM,
    LOST_LATE_S,
    LOST_LONG_S,
    LOST_SEEN_S,
    NEGLIGIBLE,
)
from hilserver.measured.channels import SETPOINTS, SPEEDS


def lost_steps(problem: Problem, point: Point) -> tuple[int, int]:
    """Return how many set-point steps reached the wheels late or never, and how many are judged.

    A step that waits for the next message is late by one message: the response seen after every
    step is compared with the simulated one, and with the same one later. A sample that was taken
    between two rows, or did not change, may be old, and a single one is no evidence. A few steps
    late by one message are chance and do not count, nor does a single event for longer: the steps
    of all wheels at one instant. If no speed changes then, measuring failed.
    """
    log, stack, stage = problem.stage.log, problem.stack, problem.stage
    both = [
        (a, b)
        for a, b in zip(SETPOINTS, SPEEDS, strict=True)
        if a in log and b in stack.edges
    ]
    if not both:
        return 0, 0
    residual = problem.residual(point.predicted)
    shown = stage.signals(point.model.terms, point.poses)
    rate_hz = 1.0 / stage.segments.period_s
    steps: list[list[float]] = []
    for setpoint, speed in both:
        edge = stack.edges[speed]
        t, r = stack.t_s[edge], residual[edge]
        stays = np.diff(stack.values[edge], prepend=np.inf) == 0.0
        stuck = stays & (stack.values[edge] != 0.0)
        rows_s, samples_s = row_period_s(log[setpoint]), row_period_s(log[speed])
        # if samples are slower than the rows, their time is known only to one row
        row_s = np.where(stays, samples_s, rows_s if samples_s > 1.5 * rows_s else 0.0)
        at_once, by_a_row, *later = (
            np.interp(
                stack.at[edge] - by_s * rate_hz,
                np.arange(len(shown[speed])),
                shown[speed],
            )
            for by_s in (0.0, row_s, row_s + 2.0 * LOST_LATE_S, row_s + LOST_LONG_S)
        )
        seen = r + at_once
        r = seen - np.clip(
            seen, np.minimum(at_once, by_a_row), np.maximum(at_once, by_a_row)
        )
        noise = problem.noise[speed].white_sd
        spans = stage.segments.span[stack.segment[edge]]
        for span in range(len(log.spans)):
            ts, s = log[setpoint].of(span)
            # stamps rise within a span only
            first, end = np.searchsorted(spans, [span, span + 1])
            for a in np.flatnonzero(np.abs(np.diff(s)) > LARGE_STEP_RPM) + 1:
                low, high = first + np.searchsorted(
                    t[first:end], [ts[a], ts[a] + LOST_SEEN_S]
                )
                two = [
                    _share(r[low:high], (g - by_a_row)[low:high], noise) for g in later
                ]
                if not np.isnan(two).all():
                    unseen = float(stuck[low:high].mean() > HALF)
                    steps.append([ts[a] + SPAN_S * span, unseen, *two])
    at, unseen_at, *shares = np.array(steps).reshape(-1, 4).T
    shows = np.isin(at, at[unseen_at == 0.0])
    if (judged := int(shows.sum())) < 12:
        return 0, 0
    is_late = np.array(shares)[:, shows] > 0.5
    late, gone = int(is_late.any(axis=0).sum()), len(np.unique(at[shows][is_late[1]]))
    return late if gone > 1 or late > NEGLIGIBLE * judged else 0, judged


def _share(r: Array, later: Array, noise: float) -> float:
    """Return the share of a later response in the data without one sample; NaN if none shows."""
    others = np.argsort(r * later)[:-1]
    power = float(later[others] @ later[others])
    if power <= 0.0 or noise / np.sqrt(power) > 0.125:
        return np.nan
    return float(r[others] @ later[others]) / power

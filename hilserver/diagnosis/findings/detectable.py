"""The smallest effect of every cause that these data would have shown."""

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.catalogue.candidate import Candidate
from hilserver.diagnosis.catalogue.traits import traits_of
from hilserver.diagnosis.catalogue.vocabulary import CAUSES
from hilserver.diagnosis.findings.explain import number
from hilserver.diagnosis.regression.columns import Library
from hilserver.diagnosis.regression.problem import Point
from hilserver.diagnosis.regression.screen import Scores, critical, null_maxima, student
from hilserver.diagnosis.replay.judgeable import UNSEEN
from hilserver.diagnosis.schema.findings import Detectable, NotJudged
from hilserver.diagnosis.thresholds import (
    BEYOND,
    DETECTABLE_LEAST_TIMES,
    DETECTABLE_POWER_SD,
    DETECTABLE_SELECTION_SD,
    DETECTABLE_SHAPES,
    HOPELESS,
    LEAST_GAIN,
)


def smallest_of(
    stages: Sequence[tuple[Library, Point]], rng: np.random.Generator
) -> tuple[list[Detectable], list[NotJudged]]:
    """Return sizes for the causes of all stages at a model, and what the drive did not excite."""
    scores = [library.scores(point) for library, point in stages]
    limit = critical(null_maxima(scores, rng)) if scores else 0.0
    found = [
        smallest(library, s, limit)
        for (library, _), s in zip(stages, scores, strict=True)
    ]
    return [size for some, _ in found for size in some], [
        one for _, some in found for one in some
    ]


def smallest(
    library: Library, scores: Scores, t_critical: float
) -> tuple[list[Detectable], list[NotJudged]]:
    """Return sizes for the causes of one stage, and those that the drive did not excite."""
    least = np.maximum(student(t_critical, scores.freedom), np.sqrt(LEAST_GAIN))
    needed = least + DETECTABLE_SELECTION_SD + DETECTABLE_POWER_SD
    judged, not_judged = [], []
    for cause, (size, name, largest) in shown_sizes(library, scores, needed).items():
        parts = CAUSES[cause].parts
        part = next((p for p in parts if p.name == name), parts[0])
        hopeless = np.inf if part.reference is None else HOPELESS * abs(part.reference)
        if size > min(largest, hopeless):
            reason = f"hardly excited: below {number(size, part.unit)} it would not be detected"
            if size > min(largest, BEYOND * hopeless):  # more than any machine can have
                reason = UNSEEN
            not_judged.append(NotJudged(cause=cause, reason=reason))
        else:
            judged.append(Detectable(cause=cause, size=size, unit=part.unit))
    return judged, not_judged


def shown_sizes(
    library: Library, scores: Scores, needed: Array
) -> dict[str, tuple[float, str, float]]:
    """Return by cause the size that would show, of which parameter, and the largest possible one.

    Parameters
    ----------
    needed : ndarray, shape (k,)
        The t that each direction must reach.
    """
    found: dict[str, list[tuple[float, str, float]]] = {}  # one of each candidate
    for i, c in enumerate(library.candidates):
        # by which `spread` divided columns
        norms = library.norms[i] if c.n > 1 else np.ones(1)
        names = list(c.terms(c.start))
        mine = np.flatnonzero(library.owner == i)[: max(c.n, 1)]
        own: list[tuple[float, str, float]] = []
        for k, j in enumerate(mine):
            information = scores.information[j]
            if information <= 1e-12:
                continue
            visible = information / max(scores.deviation[j], 1e-300)  # t per unit
            size = _size(c, float(needed[j] / visible), float(norms[k]))
            if size is None:
                continue
            name = (
                names[k]
                if k < len(names) and not names[k].endswith("phase")
                else names[0]
            )
            largest = max(c.high[k] - c.null[k], c.null[k] - c.low[k])
            own.append((size, name, np.inf if c.is_limit else float(largest)))
        if own:
            best = max(own) if c.is_limit else min(own)
            found.setdefault(c.cause, []).append(best)

    shapes = Counter(c.cause for c in library.candidates if c.hidden)
    sizes: dict[str, tuple[float, str, float]] = {}
    for cause, each in found.items():
        each.sort(reverse=traits_of(cause).is_limit)
        # any start of a search will do, but a shape is what it is
        shown = math.ceil(DETECTABLE_SHAPES * shapes[cause])
        sizes[cause] = each[min(max(shown, 1), len(each)) - 1]
    return sizes


def _size(candidate: Candidate, times: float, norm: float) -> float | None:
    """Return the size that shows, as distance from null; for a limit, which has none, its value.

    Parameters
    ----------
    times : float
        Units of the candidate's column that would show.
    """
    if candidate.is_limit:
        return candidate.start[0] if times <= 1.0 else None
    if candidate.linear:
        size = times / norm
    elif times <= 1.5:
        size = abs(candidate.start[0] - candidate.null[0]) * times
    else:
        return None
    return float(max(size, DETECTABLE_LEAST_TIMES * candidate.least))

"""What a diagnosis could find in a manoeuvre: sizes, groups, and what it cannot judge."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.catalogue.traits import traits_of
from hilserver.diagnosis.catalogue.vocabulary import CAUSES, reference
from hilserver.diagnosis.checks.standstill import at_rest
from hilserver.diagnosis.findings.detectable import smallest
from hilserver.diagnosis.plan.information import (
    Z_APART,
    GramDirection,
    alike,
    apart,
    directions_of,
    gram_of,
    nearest,
    score,
    sizes_of,
)
from hilserver.diagnosis.plan.manoeuvre import Manoeuvre
from hilserver.diagnosis.plan.null_log import PlannedRecording, Studio
from hilserver.diagnosis.regression.screen import critical, null_maxima
from hilserver.diagnosis.regression.stages import Prepared, prepare_all
from hilserver.diagnosis.replay.judgeable import vocabulary_reasons
from hilserver.diagnosis.schema.findings import Detectable, NotJudged
from hilserver.diagnosis.thresholds import GROUP_COSINE, HOPELESS

OTHERWISE = "not found by its sensitivity; the plan does not cover it"
LEAST_SHOWN = 0.1
"""A limit that shows only below a tenth of its reference effect is not worth a name."""
NOT_SEEN = "the manoeuvre does not excite it"


@dataclass(frozen=True)
class Outlook:
    """What one manoeuvre can show."""

    sizes: dict[str, Detectable]  # smallest detectable size of each cause
    # causes that cannot be separated: each resembles another of its group
    groups: list[tuple[str, ...]]
    pairs: dict[tuple[str, str], float]  # |cos| of the pairs above the limit
    not_judged: dict[str, str]  # reasons
    score: float  # total information, `information.score`

    def share(self, cause: str) -> float | None:
        """Return a cause's smallest detectable size as a share of its reference size."""
        found = self.sizes.get(cause)
        size = None if found is None else reference(cause, cause)
        if found is None or size is None:
            return None
        return size / found.size if traits_of(cause).is_limit else found.size / size

    @property
    def shown(self) -> list[str]:
        """Causes that are visible at their reference size, or that have none."""
        return [
            c for c in self.sizes if (share := self.share(c)) is None or share <= 1.0
        ]

    @property
    def named(self) -> list[str]:
        """Causes that are visible and can be separated from all others."""
        together = {c for group in self.groups for c in group}
        return [c for c in self.shown if c not in together]


def look(
    spans: Sequence[Manoeuvre], recording: PlannedRecording, studio: Studio
) -> Outlook:
    """Replay a manoeuvre, add the reference noises and ask what a diagnosis could find."""
    log, rng = studio.null_log(spans, recording)
    prepared, reasons = prepare_all(log, studio.robot, studio.jobs, studio.report)
    found = judge(prepared, reasons, rng)
    return found if any(m.setpoints_rpm.any() for m in spans) else _at_rest(found)


def _at_rest(found: Outlook) -> Outlook:
    """Return the outlook of a manoeuvre that asks for no motion."""
    shown, unseen = at_rest(list(found.sizes.values()), ())
    reasons = found.not_judged | {n.cause: n.reason for n in unseen}
    return replace(
        found,
        sizes={d.cause: d for d in shown},
        groups=[],
        pairs={},
        not_judged=reasons,
    )


def judge(
    prepared: dict[str, Prepared], reasons: dict[str, str], rng: np.random.Generator
) -> Outlook:
    """Return the outlook of a prepared null log."""
    scores = {name: p.library.scores(p.base) for name, p in prepared.items()}
    limit = critical(null_maxima(list(scores.values()), rng)) if scores else 0.0
    sizes: dict[str, Detectable] = {}
    silent: list[NotJudged] = []
    pairs: dict[tuple[str, str], float] = {}
    excited: set[str] = set()
    total = 0.0
    for name, p in prepared.items():
        found, unseen = smallest(p.library, scores[name], limit)
        silent += unseen
        for d in found:
            size = reference(d.cause, d.cause)
            if size is None or d.size <= HOPELESS * size:
                sizes[d.cause] = d
        excited |= {c.cause for c in p.library.candidates}
        directions, gram = directions_of(p.library), gram_of(p.library)
        sizes |= limits(directions, gram)
        total += score(directions, gram)
        pairs |= confused(directions, gram, set(sizes))
    reasons = {n.cause: n.reason for n in silent if n.cause not in sizes} | reasons
    reasons = vocabulary_reasons(set(sizes), reasons, set(prepared))
    for cause, entry in CAUSES.items():
        if entry.physical and cause not in sizes and cause not in reasons:
            reasons[cause] = NOT_SEEN if cause in excited else OTHERWISE
    return Outlook(sizes, grouped(pairs), pairs, reasons, total)


def limits(directions: Sequence[GramDirection], gram: Array) -> dict[str, Detectable]:
    """Return the largest visible limits; `smallest` cannot, as their null is not a number."""
    found: dict[str, Detectable] = {}
    for d, share in zip(directions, sizes_of(directions, gram), strict=True):
        if d.candidate.is_limit and d.sizes[0] and share <= HOPELESS:
            size = d.sizes[0] / max(float(share), LEAST_SHOWN)
            if d.cause not in found or size > found[d.cause].size:
                found[d.cause] = Detectable(
                    cause=d.cause, size=size, unit=CAUSES[d.cause].unit
                )
    return found


def confused(
    directions: Sequence[GramDirection], gram: Array, visible: set[str]
) -> dict[tuple[str, str], float]:
    """Return the pairs of visible causes that imitate each other, with their |cos|.

    As in a diagnosis, their sensitivities are alike and what remains of one of them at its
    reference size does not decide between them.
    """
    cosines, z = alike(directions, gram), apart(directions, gram)
    chosen = {c: rows for c, rows in nearest(directions).items() if c in visible}
    names = list(chosen)
    found = {}
    for i, a in enumerate(names):
        for b in names[i + 1 :]:
            rows = np.ix_(chosen[a], chosen[b])
            close = (cosines[rows] > GROUP_COSINE) & (
                np.minimum(z[rows], z.T[rows]) < Z_APART
            )
            if close.any():
                found[a, b] = float(cosines[rows][close].max())
    return found


def grouped(pairs: dict[tuple[str, str], float]) -> list[tuple[str, ...]]:
    """Return the largest sets in which every two causes are alike."""
    near: dict[str, set[str]] = {}
    for a, b in pairs:
        near.setdefault(a, set()).add(b)
        near.setdefault(b, set()).add(a)
    found: list[tuple[str, ...]] = []

    def extend(clique: list[str], able: list[str], done: list[str]) -> None:
        if not able and not done:
            found.append(tuple(sorted(clique)))
        for cause in list(able):
            mine = near[cause]
            extend(
                [*clique, cause],
                [c for c in able if c in mine],
                [c for c in done if c in mine],
            )
            able.remove(cause)
            done.append(cause)

    if near:
        extend([], sorted(near), [])
    return sorted(found)

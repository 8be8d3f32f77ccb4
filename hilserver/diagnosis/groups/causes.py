"""One list of causes for all groups, from what each group's logs say by themselves."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from hilserver.diagnosis.catalogue.candidate import Candidate
from hilserver.diagnosis.decide.settling import Judged
from hilserver.diagnosis.replay.model import Fitted


@dataclass(frozen=True)
class Cause:
    """A cause that at least one group shows.

    Attributes
    ----------
    fitted : Fitted
        Where a fit begins.
    rivals : mapping of str to Fitted
        What no group that shows it can tell it from, by cause.
    p : float
        Of chance, in the group that shows it most clearly.
    drifts : bool
        In at least one group.
    """

    fitted: Fitted
    rivals: Mapping[str, Fitted]
    p: float
    drifts: bool

    @property
    def name(self) -> str:
        """Its name."""
        return self.fitted.candidate.cause

    @property
    def candidate(self) -> Candidate:
        """Its candidate."""
        return self.fitted.candidate

    @property
    def names(self) -> frozenset[str]:
        """It and its rivals."""
        return frozenset({self.name, *self.rivals})


def causes_of(judged: Sequence[Judged]) -> list[Cause]:
    """Return the causes that the groups show in one stage, without twins of each other.

    What one group names alone another may not be able to tell from a twin: the one that is named
    alone stands for both.
    """
    shown = [cause for j in judged for cause in _of(j, len(judged))]
    chosen: list[Cause] = []
    for cause in sorted(shown, key=lambda c: len(c.names)):
        place = next((i for i, c in enumerate(chosen) if c.name in cause.names), None)
        if place is None:
            chosen.append(cause)
            continue
        known = chosen[place]
        chosen[place] = replace(
            known,
            rivals={n: f for n, f in known.rivals.items() if n in cause.names},
            p=min(known.p, cause.p),
            drifts=known.drifts or cause.drifts,
        )
    return chosen


def _of(j: Judged, groups: int) -> list[Cause]:
    """Return the causes of one group; with every group chance has one more opportunity."""
    out = []
    for f in j.point.model.fitted:
        cause = f.candidate.cause
        rivals = {
            r.candidate.cause: r.fitted for r in j.ties.get(cause, ()) if r.candidate.cause != cause
        }
        p = j.drift.get(cause, j.selected.p.get(cause, 0.01))
        out.append(Cause(f, rivals, min(groups * p, 1.0), cause in j.drift))
    return out

"""One list of causes for all groups, from what the logs of each group show on their own."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from hilserver.diagnosis.catalogue.candidate import Candidate
from hilserver.diagnosis.decide.revision import JudgedStage
from hilserver.diagnosis.findings.outcome import chance
from hilserver.diagnosis.replay.model import Fitted


@dataclass(frozen=True)
class GroupCause:
    """A cause that at least one group shows."""

    fitted: Fitted  # where a fit starts
    # causes from which no group that shows it can separate it
    rivals: Mapping[str, Fitted]
    p: float  # of chance, in the group that shows it most clearly
    drifts: bool  # in at least one group

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


def causes_of(judged: Sequence[JudgedStage]) -> list[GroupCause]:
    """Return the causes that the groups show in one stage, without twins of each other.

    A cause that one group names alone may have a twin in another group. The one named alone then
    stands for both.
    """
    shown = [cause for j in judged for cause in _of(j, len(judged))]
    chosen: list[GroupCause] = []
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


def _of(j: JudgedStage, groups: int) -> list[GroupCause]:
    """Return the causes of one group; every group is one more opportunity for chance."""
    out = []
    for f in j.point.model.fitted:
        cause = f.candidate.cause
        if cause in j.effective:
            continue  # it asserts nothing that another group could share
        rivals = {
            r.candidate.cause: r.fitted
            for r in j.ties.get(cause, ())
            if r.candidate.cause != cause
        }
        p = min(groups * chance(j, cause), 1.0)
        out.append(GroupCause(f, rivals, p, cause in j.drift))
    return out

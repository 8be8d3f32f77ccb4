"""A proposal, and a table of its stages from open to measured."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from typing import Any, Final, Self

from pydantic import ConfigDict, TypeAdapter

from hilserver.errors import ControlRefused

Interval = tuple[float, float]
STRICT: Final = ConfigDict(strict=True, extra="forbid")
"""How proposals, orders and results are read: what another version has written is none of them."""


class ProposalStage(StrEnum):
    """Where a proposal is."""

    OPEN = "open"
    POSTPONED = "postponed"
    ACCEPTED = "accepted"
    REJECTED = "rejected"
    REPLACED = "replaced"
    BETTER = "better"
    NOT_BETTER = "not_better"


class ProposalStep(StrEnum):
    """What changes the stage: methods of OPC UA first, then steps of the loop itself."""

    ACCEPT = "AcceptProposal"
    REJECT = "RejectProposal"
    POSTPONE = "PostponeProposal"
    REPLACE = "replace"
    REOPEN = "reopen"
    GAINED = "gained"
    LOST = "lost"


_WAITING: Final = (ProposalStage.OPEN, ProposalStage.POSTPONED)
FOLLOWING: Final[
    Mapping[ProposalStep, tuple[tuple[ProposalStage, ...], ProposalStage]]
] = {
    ProposalStep.ACCEPT: (_WAITING, ProposalStage.ACCEPTED),
    ProposalStep.REJECT: (_WAITING, ProposalStage.REJECTED),
    ProposalStep.POSTPONE: ((ProposalStage.OPEN,), ProposalStage.POSTPONED),
    ProposalStep.REPLACE: ((*_WAITING, ProposalStage.ACCEPTED), ProposalStage.REPLACED),
    ProposalStep.REOPEN: ((ProposalStage.ACCEPTED,), ProposalStage.OPEN),
    ProposalStep.GAINED: ((ProposalStage.ACCEPTED,), ProposalStage.BETTER),
    ProposalStep.LOST: ((ProposalStage.ACCEPTED,), ProposalStage.NOT_BETTER),
}
"""For each step: the stages in which it is possible, and the one that follows."""


@dataclass(frozen=True)
class ProposedTerm:
    """One value of a proposal."""

    value: float  # of the term after acceptance
    unit: str
    ci95: Interval | None = None
    present: float | None = None  # present value; None: off

    @property
    def interval(self) -> Interval:
        """Where its value lies; without an interval that value alone."""
        return self.ci95 or (self.value, self.value)


@dataclass(frozen=True)
class Quantity:
    """The gap in one quantity on a window: with the model at work, and with the other."""

    before: float
    after: float
    ratio: float
    ci95: Interval | None = None


@dataclass(frozen=True)
class Proposal:
    """What an engineer decides on."""

    __pydantic_config__ = STRICT

    number: int
    causes: tuple[str, ...]
    sentence: str
    terms: Mapping[str, ProposedTerm]  # all that the patch has
    # terms that are off once it is accepted, with what they have now
    gone: Mapping[str, float] = field(default_factory=dict)
    gain: Mapping[str, Quantity] = field(default_factory=dict)
    p: float = 1.0
    level: float = 0.0
    # where the terms were fitted, as in a patch
    fitted: Mapping[str, Any] = field(default_factory=dict)
    # file names in folders.patches; the second takes the first back
    patch: str = ""
    former: str = ""
    report: str = ""
    windows: tuple[int, ...] = ()  # named on the first, confirmed on the second
    stage: ProposalStage = ProposalStage.OPEN
    effect: Mapping[str, Quantity] = field(default_factory=dict)

    @property
    def waits(self) -> bool:
        """Whether somebody still has to decide."""
        return self.stage in _WAITING

    def after(self, step: ProposalStep) -> Self:
        """Return it one step further; ControlRefused if that is not possible where it is."""
        possible, following = FOLLOWING[step]
        if self.stage not in possible:
            raise ControlRefused(
                f"{step}: proposal {self.number} is {self.stage}, not open"
            )
        return replace(self, stage=following)

    def within(self, ranges: Mapping[str, Interval]) -> bool:
        """Whether every change has a range and stays within it."""
        changed = {n: t.value for n, t in self.terms.items() if t.value != t.present}
        if not {*changed, *self.gone} <= ranges.keys():
            return False
        return all(
            ranges[n][0] <= value <= ranges[n][1] for n, value in changed.items()
        )

    def resembles(self, other: "Proposal") -> bool:
        """Whether it repeats another: the same terms, with intervals that overlap.

        A change of another running model is another proposal.
        """
        if self.terms.keys() != other.terms.keys() or self.gone != other.gone:
            return False
        if any(
            term.present != other.terms[name].present
            for name, term in self.terms.items()
        ):
            return False
        return all(_meet(term, other.terms[name]) for name, term in self.terms.items())

    def as_json(self) -> dict[str, Any]:
        """Return it as plain data."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Any) -> "Proposal":
        """Return what `as_json` has written.

        Raises
        ------
        ValueError
            If the data are not a proposal.
        """
        # strict about types of JSON, not Python
        return _PROPOSAL.validate_json(json.dumps(data))


_PROPOSAL: Final = TypeAdapter(Proposal)


def values_of(terms: Mapping[str, ProposedTerm]) -> dict[str, float]:
    """Return the values of terms."""
    return {name: term.value for name, term in terms.items()}


def _meet(one: ProposedTerm, other: ProposedTerm) -> bool:
    a = one.interval
    b = other.interval
    return a[0] <= b[1] and b[0] <= a[1]

"""Which window is judged, and what follows from the result: no clock, no file, no process.

A cause is named on one window. On the next one, which took no part in that, both models are
compared; only if the new one is better there, at the level that the budget allows, is it proposed.
"""

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from hilserver.errors import ControlRefused
from hilserver.recalibration.flips import FlipTest, fewest_blocks
from hilserver.recalibration.orders import (
    JudgeResult,
    Looked,
    ModelsCompared,
    Todo,
    Values,
)
from hilserver.recalibration.proposals import (
    Proposal,
    ProposalStage,
    ProposalStep,
    ProposedTerm,
    Quantity,
    values_of,
)
from hilserver.recalibration.spending import Spending

EFFECT_LEVEL: Final = 0.05
"""Level of the test whether an accepted proposal has helped; if not, the way back is proposed."""
REMEMBERED: Final = 50  # rejected proposals, which are not repeated


@dataclass(frozen=True)
class Note:
    """A line for the history; one with a sentence is an event as well."""

    kind: str
    fields: Mapping[str, Any]
    sentence: str = ""
    severity: int = 200


@dataclass(frozen=True)
class WaitingWindow:
    """What one window shows, waiting for the next to confirm it."""

    window: int
    loaded: Values
    looked: Looked
    level: float


class RecalibrationLoop:
    """The rules.

    Parameters
    ----------
    every_s : float or None
        Longest time between two looks.
    now_s : float
        Start of the first window.
    """

    def __init__(self, every_s: float | None, spending: Spending, now_s: float) -> None:
        self._every_s = every_s
        self._spending = spending
        self._looked_s = now_s
        self._candidate: WaitingWindow | None = None
        self._rejected: deque[Proposal] = deque(maxlen=REMEMBERED)
        self._accepted_in: int | None = None
        self.proposal: Proposal | None = None  # the newest
        # channel whose gap has left its usual range since the last look
        self.changed: str | None = None
        self.count = 0

    # --- windows ----------------------------------------------------------------------------------

    def overtaken(self, loaded: Values) -> list[Note]:
        """Close an accepted proposal that no longer runs: its effect cannot be measured."""
        if not self._is_undone(loaded):
            return []
        assert self.proposal is not None
        self.proposal = self.proposal.after(ProposalStep.REPLACE)
        self._accepted_in = None
        text = f"proposal {self.proposal.number} is no longer active: its effect is not measured"
        return [
            Note("decision", {"who": "", "proposal": self.proposal.as_json()}, text)
        ]

    def _is_undone(self, loaded: Values) -> bool:
        """Whether the running model is no longer that of the accepted proposal."""
        if self.proposal is None or self.proposal.stage is not ProposalStage.ACCEPTED:
            return False
        return values_of(self.proposal.terms) != loaded

    def todo(self, window: int, loaded: Values, now_s: float) -> Todo | None:
        """Return what to do with a complete window; None if nothing."""
        candidate = self._candidate
        proposal = self.proposal
        if candidate is not None and candidate.loaded != loaded:
            candidate = self._candidate = None
        measure = None
        began = self._accepted_in
        if (
            proposal is not None
            and proposal.stage is ProposalStage.ACCEPTED
            and began is not None
        ):
            measure = present(proposal) if window > began else None
        is_due = self._every_s is not None and now_s - self._looked_s >= self._every_s
        confirm = None if candidate is None else values_of(candidate.looked.terms)
        level = 0.0 if candidate is None else candidate.level
        found = Todo(
            window,
            dict(loaded),
            measure=measure,
            confirm=confirm,
            level=level,
            look=is_due or self.changed is not None,
        )
        if found.look or candidate is not None or measure is not None:
            return found
        return None

    def take(self, todo: Todo, result: JudgeResult, now_s: float) -> list[Note]:
        """Take the result of a window; return what is to be recorded and announced."""
        notes: list[Note] = []
        if result.error:
            self._candidate = None
            text = f"window {todo.window} could not be diagnosed: {result.error}"
            notes.append(
                Note(
                    "failed", {"window": todo.window, "error": result.error}, text, 500
                )
            )
        if result.measure is not None:
            notes += self._measured(todo, result.measure)
        if result.confirm is not None:
            notes += self._confirmed(todo, result.confirm)
        if result.look is not None:
            since_s = now_s - self._looked_s
            self._looked_s = now_s
            self.changed = None
            level = self._spending.confirmation(since_s)
            if result.look.verdict == "named":
                self._candidate = WaitingWindow(
                    todo.window, todo.loaded, result.look, level
                )
            spent = {"joint": self._spending.joint(since_s), "confirmation": level}
            found = {
                "verdict": result.look.verdict,
                "causes": result.look.causes,
                "sentence": result.look.sentence,
            }
            seen = Note(
                "look",
                {"window": todo.window, **found, "p": result.look.p, "spent": spent},
            )
            notes.append(seen)
            notes += [
                Note("data_fault", {"window": todo.window, "sentence": one}, one, 500)
                for one in result.look.faults
            ]
        return notes

    def _confirmed(self, todo: Todo, compared: ModelsCompared) -> list[Note]:
        candidate = self._candidate
        self._candidate = None
        if candidate is None:
            return []
        looked = candidate.looked
        level = candidate.level
        fields: dict[str, Any] = {"window": todo.window, "named_on": candidate.window}
        fields |= {"level": level, "p": compared.p}
        fields |= {"resolution": compared.resolution, "blocks": compared.blocks}
        if not compared.resolves(level):
            why = too_little(todo.window, compared, level)
            return [
                Note("confirmation", {**fields, "verdict": "no_test", "sentence": why})
            ]
        if not compared.holds(level):
            return [Note("confirmation", {**fields, "verdict": "not_confirmed"})]
        made = Proposal(
            number=self.count + 1,
            causes=looked.causes,
            sentence=looked.sentence,
            terms=looked.terms,
            gone=looked.gone,
            fitted=looked.fitted,
            patch=file_of(self.count + 1),
            former=file_of(self.count + 1, "-former"),
            gain=compared.gain,
            p=compared.p,
            level=level,
            windows=(candidate.window, todo.window),
        )
        if self.proposal is not None and self.proposal.waits:
            waiting = [self.proposal]
        else:
            waiting = []
        if any(made.resembles(other) for other in (*self._rejected, *waiting)):
            return [Note("confirmation", {**fields, "verdict": "known"})]
        notes = [Note("confirmation", {**fields, "verdict": "confirmed"})]
        return notes + self._propose(made)

    def _propose(self, made: Proposal) -> list[Note]:
        notes: list[Note] = []
        if self.proposal is not None and self.proposal.waits:
            self.proposal = self.proposal.after(ProposalStep.REPLACE)
            notes.append(
                Note("decision", {"who": "", "proposal": self.proposal.as_json()})
            )
        self.count = made.number
        self.proposal = made
        return [
            *notes,
            Note("proposal", {"proposal": made.as_json()}, announced(made), 400),
        ]

    def _measured(self, todo: Todo, compared: ModelsCompared) -> list[Note]:
        before = self.proposal
        if before is None or before.stage is not ProposalStage.ACCEPTED:
            return []
        fields: dict[str, Any] = {"window": todo.window, "p": compared.p}
        if not compared.resolves(
            EFFECT_LEVEL
        ):  # the robot stood still: the next window decides
            why = too_little(todo.window, compared, EFFECT_LEVEL)
            return [Note("effect", {**fields, "verdict": "too_short", "sentence": why})]
        self._accepted_in = None
        is_better = compared.holds(EFFECT_LEVEL)
        after = before.after(ProposalStep.GAINED if is_better else ProposalStep.LOST)
        self.proposal = replace(after, effect=compared.gain)
        fields["proposal"] = self.proposal.as_json()
        if is_better:
            text = f"proposal {before.number} was right: {gained(compared.gain)}"
            return [Note("effect", {**fields, "verdict": "better"}, text)]
        text = f"proposal {before.number} did not make the gap smaller"
        note = Note("effect", {**fields, "verdict": "not_better"}, text, 500)
        if not before.gain:  # it was itself a way back: neither model is better
            return [note]
        way_back = back(before, self.count + 1, todo.window)
        return [note, *self._propose(way_back)]

    # --- decisions --------------------------------------------------------------------------------

    def decided(self, step: ProposalStep, number: int) -> Proposal:
        """Return the proposal after a decision; nothing changes until `adopt`.

        Raises
        ------
        ControlRefused
            If no proposal has that number, or it is already decided.
        """
        if self.proposal is None or self.proposal.number != number:
            if self.proposal is None:
                newest = "there is no proposal"
            else:
                newest = f"that is {self.proposal.number}"
            raise ControlRefused(
                f"{step}: {number} is not the latest proposal: {newest}"
            )
        return self.proposal.after(step)

    def adopt(self, decided: Proposal, recording: int) -> None:
        """Continue after a decision.

        Parameters
        ----------
        recording : int
            Window that is being written, which contains both models.
        """
        self.proposal = decided
        self._candidate = None
        if decided.stage is ProposalStage.REJECTED:
            self._rejected.append(decided)
        if decided.stage is ProposalStage.ACCEPTED:
            self._accepted_in = recording
            self.changed = None

    def restore(
        self, lines: Iterable[Mapping[str, Any]], loaded: Values, window: int
    ) -> None:
        """Restore the state of an earlier run: the newest proposal, and those rejected.

        An accepted proposal is open again unless the daemon starts with its patch; its effect is
        then measured on the windows after `window`.
        """
        for line in lines:
            try:
                found = Proposal.from_json(line["proposal"])
                self.count = max(self.count, found.number)
            except (ValueError, KeyError):
                continue  # a line of another kind or version
            self.proposal = found
            if found.stage is ProposalStage.REJECTED:
                self._rejected.append(found)
        if self.proposal is not None and self.proposal.stage is ProposalStage.ACCEPTED:
            self._accepted_in = window
            if self._is_undone(loaded):
                self.proposal = self.proposal.after(ProposalStep.REOPEN)
                self._accepted_in = None


def too_little(window: int, answer: FlipTest, level: float) -> str:
    """Explain why a window cannot tell which of two models is better."""
    return (
        f"In {answer.blocks} stretches of window {window} the robot moved so that the two models"
        f" differ; it takes {fewest_blocks(level)} to say which is better."
    )


def file_of(number: int, kind: str = "") -> str:
    """Return the name of a patch file."""
    return f"recalibrated-{number:04d}{kind}.yaml"


def present(proposal: Proposal) -> dict[str, float]:
    """Return the terms of the model before a proposal."""
    kept = {name: term.present for name, term in proposal.terms.items()}
    return {n: v for n, v in {**kept, **proposal.gone}.items() if v is not None}


def back(proposal: Proposal, number: int, window: int) -> Proposal:
    """Return the proposal that undoes an accepted one."""
    now = values_of(proposal.terms)
    before = present(proposal)
    units = {name: term.unit for name, term in proposal.terms.items()}
    return Proposal(
        number=number,
        causes=proposal.causes,
        sentence=f"Proposal {proposal.number} did not make the gap smaller: return to the"
        " previous model.",
        terms={
            n: ProposedTerm(v, units.get(n, "1"), None, now.get(n))
            for n, v in before.items()
        },
        gone={name: value for name, value in now.items() if name not in before},
        windows=(*proposal.windows, window),
        patch=proposal.former,
        former=proposal.patch,
    )


def gained(gain: Mapping[str, Quantity]) -> str:
    """Return the gap before and after in words, the quantity that gains most first."""
    rows = sorted(gain.items(), key=lambda row: -row[1].ratio)
    return ", ".join(
        f"{n} {q.before:.3g} to {q.after:.3g} ({q.ratio:.2g} times)" for n, q in rows
    )


def announced(proposal: Proposal) -> str:
    """Return the sentence of the event."""
    return f"proposal {proposal.number} needs a decision: {proposal.sentence}"

"""A robot of another program over many windows, by the daemon's rules, in virtual time.

The same loop and looks as in the daemon; every window is diagnosed, every proposal accepted.
"""

import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from hilserver_injector import Noise, Recipe, make

from hilserver.config.root import Config, without_passwords
from hilserver.recalibration.judging import OrderJudge
from hilserver.recalibration.loop import Note, RecalibrationLoop
from hilserver.recalibration.orders import JudgeOrder, Todo
from hilserver.recalibration.proposals import Proposal, ProposalStage, ProposalStep
from hilserver.recalibration.spending import Spending

Values = Mapping[str, float]


@dataclass(frozen=True)
class Drive:
    """Some windows of one drive, with hidden causes.

    Attributes
    ----------
    before : mapping of str to float, optional
        What is hidden up to the middle of the drive; default: the same throughout.
    """

    windows: int
    hidden: Values
    before: Values | None = None


@dataclass(frozen=True)
class Case:
    """Drives of one robot, one after the other."""

    row: str
    name: str
    drives: tuple[Drive, ...]
    window_s: float
    seed: int
    hidden: Values = field(default_factory=dict)  # causes to be found
    appears: int = 0  # window in which it appears; from 1
    measured_noise: bool = False

    @property
    def key(self) -> str:
        """Name of its line among the results."""
        size = ", ".join(f"{name} {value:.4g}" for name, value in self.hidden.items())
        return f"{self.row}: {self.name}, {size or 'nothing'}, {self.window_s:g} s, {self.seed}"


@dataclass
class Outcome:
    """Result of a case.

    Attributes
    ----------
    looks, confirmations : list of str
        Verdicts, in order.
    proposed : list of dict
        Window, causes, terms (value, interval, value before), gain on the confirming window.
    effects : dict of list of float
        By proposal: gap before divided by gap after, for quantities with a confirmed gain.
    loaded : dict of float
        Terms that run at the end.
    """

    looks: list[str] = field(default_factory=list)
    confirmations: list[str] = field(default_factory=list)
    proposed: list[dict[str, Any]] = field(default_factory=list)
    effects: dict[int, list[float]] = field(default_factory=dict)
    loaded: dict[str, float] = field(default_factory=dict)
    errors: list[str] = field(default_factory=list)
    seconds: float = 0.0


def windows(case: Case, folder: Path) -> Iterator[Path]:
    """Write the windows of a robot's drives, one after the other."""
    for part, drive in enumerate(case.drives):
        table, _ = make(
            Recipe(
                seed=1000 * case.seed + part,
                causes=drive.hidden,
                drift_from=drive.before,
                drift_step=drive.before is not None,
                duration_s=drive.windows * case.window_s,
                noise=Noise(measured_position=case.measured_noise),
            )
        )
        number = np.minimum(table.t_s // case.window_s, drive.windows - 1).astype(int)
        for window in range(drive.windows):
            rows = number == window
            cut = type(table)(
                table.t_s[rows], {n: v[rows] for n, v in table.columns.items()}
            )
            path = folder / f"window_{part}_{window}.csv"
            cut.write_csv(path)
            yield path
            path.unlink()


class Robot:
    """A robot of a case: its loop, its running model, and the result so far."""

    def __init__(self, case: Case) -> None:
        self.outcome = Outcome()
        self._window_s, self._number = case.window_s, 0
        self._loop = RecalibrationLoop(case.window_s, Spending(), 0.0)

    def window(self, path: Path) -> None:
        """Diagnose one window, and accept what is proposed."""
        self._number += 1
        now_s, loop, outcome = self._number * self._window_s, self._loop, self.outcome
        todo = loop.todo(self._number, outcome.loaded, now_s)
        if todo is None:
            return
        self._count(loop.take(todo, OrderJudge(order(todo, path)).result(), now_s))
        proposal = loop.proposal
        if proposal is not None and proposal.stage is ProposalStage.OPEN:
            outcome.proposed.append(summary(self._number, proposal))
            decided = loop.decided(ProposalStep.ACCEPT, proposal.number)
            loop.adopt(decided, self._number)  # the next window begins after it
            outcome.loaded = {n: t.value for n, t in decided.terms.items()}

    def _count(self, notes: Sequence[Note]) -> None:
        for note in notes:
            verdict = str(note.fields.get("verdict", ""))
            if note.kind == "look":
                self.outcome.looks.append(verdict)
            if note.kind == "confirmation":
                self.outcome.confirmations.append(verdict)
            if note.kind == "effect":
                proposal = Proposal.from_json(note.fields["proposal"])
                self.outcome.effects[proposal.number] = gained(proposal)
            if note.kind == "failed":
                self.outcome.errors.append(note.sentence)


def order(todo: Todo, path: Path) -> JudgeOrder:
    """Return the order to look at a window of the default robot."""
    return JudgeOrder(
        todo, str(path), without_passwords(Config()), str(path.parent), {}, ""
    )


def summary(window: int, proposal: Proposal) -> dict[str, Any]:
    """Return a proposal as plain data."""
    terms = {n: (t.value, t.ci95, t.present) for n, t in proposal.terms.items()}
    gain = {n: q.ratio for n, q in proposal.gain.items()}
    causes = list(proposal.causes)
    return {
        "window": window,
        "causes": causes,
        "terms": terms,
        "gain": gain,
        "p": proposal.p,
    }


def gained(proposal: Proposal) -> list[float]:
    """Return the effect on the quantities whose gain was confirmed."""
    names = [
        n for n, q in proposal.gain.items() if q.ci95 is not None and q.ci95[0] > 1.0
    ]
    return [proposal.effect[n].ratio for n in names if n in proposal.effect]


def run(case: Case) -> Outcome:
    """Run one case."""
    robot, begun_s = Robot(case), time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        for path in windows(case, Path(name)):
            robot.window(path)
    robot.outcome.seconds = round(time.monotonic() - begun_s, 1)
    return robot.outcome


def counts(outcomes: Sequence[Mapping[str, Any]], key: str) -> Counter[str]:
    """Return the number of each verdict."""
    return Counter(verdict for one in outcomes for verdict in one[key])

"""Whether the model keeps up: ``python -m benchmarks.recalibration``, from a checkout.

A robot of another program drives over many windows and is looked at by the rules of the daemon: the
same loop, the same looks, every window one look. Rows of the result:

kinds
    A hidden cause appears between two windows. Proposed within three, and nothing wrong; the gap
    after it is accepted, on a window that took no part.
back
    A cause appears, and goes again: the second proposal takes the first back.
null
    Nothing changes but the floor, within its noise. How often something is named, and confirmed;
    both windows are of one track. The rate a year is extrapolated.
"""

import argparse
import json
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from statistics import median
from typing import Any, Final

import numpy as np
from hilserver_injector import Recipe, make
from hilserver_injector.causes import CAUSES, TWINS

from benchmarks.binomial import clopper_pearson
from hilserver.config.root import Config, without_passwords
from hilserver.program.workers import in_processes
from hilserver.recalibration.judging import Judge
from hilserver.recalibration.loop import Loop, Note
from hilserver.recalibration.orders import Order
from hilserver.recalibration.proposals import Proposal, Stage, Step
from hilserver.recalibration.spending import YEAR_S, Spending

KINDS: Final = (
    "rotation_gain",
    "wheel_radius",
    "wheel_radius_difference",
    "longitudinal_slip",
    "side_slip",
    "nav_latency",
    "yaw_latency",
    "gyro_bias",
    "gyro_scale",
    "nav_lever_arm",
    "actuation_delay",
    "saturation_limit",
)
BACK: Final = ("rotation_gain", "gyro_bias", "actuation_delay", "nav_latency", "saturation_limit")
BEFORE: Final = 3
"""Windows without the cause; as many follow with it."""
DEADLINE: Final = 3
FLOOR: Final = 0.001
"""Rotation gain by which the floor differs from window to window: below any size worth a name."""

Values = Mapping[str, float]


@dataclass(frozen=True)
class Track:
    """One drive: what is hidden in it, before and after its middle."""

    name: str
    seed: int
    first: Values
    last: Values
    windows: int = 2 * BEFORE


@dataclass(frozen=True)
class Case:
    """Tracks of one robot, one after the other; every proposal is accepted."""

    row: str
    name: str
    tracks: tuple[Track, ...]
    window_s: float


@dataclass
class Outcome:
    """What came of a case.

    Attributes
    ----------
    proposed : list of (int, str, list of str)
        Window, what it says, and its causes.
    looks : dict of int
        By verdict.
    effects : dict of list of float
        By proposal: gap before by gap after of the quantities that gained where it was confirmed.
    loaded : dict of float
        Terms that run at the end.
    """

    row: str
    name: str
    proposed: list[tuple[int, str, list[str]]] = field(default_factory=list)
    looks: dict[str, int] = field(default_factory=dict)
    confirmations: dict[str, int] = field(default_factory=dict)
    effects: dict[int, list[float]] = field(default_factory=dict)
    loaded: dict[str, float] = field(default_factory=dict)


def cut(track: Track, window_s: float, folder: Path) -> Iterator[Path]:
    """Write the windows of a track, one after the other."""
    recipe = Recipe(
        seed=track.seed,
        causes=track.last,
        drift_from=track.first,
        drift_step=True,
        duration_s=track.windows * window_s,
    )
    table, _ = make(recipe)
    number = np.minimum(table.t_s // window_s, track.windows - 1).astype(int)
    for window in range(track.windows):
        rows = number == window
        part = type(table)(table.t_s[rows], {n: v[rows] for n, v in table.columns.items()})
        path = folder / f"{track.name}_{window}.csv"
        part.write_csv(path)
        yield path


class Robot:
    """A robot of a case: its loop, the model that runs, and what has come of it."""

    def __init__(self, case: Case) -> None:
        self.outcome = Outcome(case.row, case.name)
        self._window_s, self._number = case.window_s, 0
        self._loop = Loop(case.window_s, Spending(), 0.0)
        self._looks, self._confirmations = Counter[str](), Counter[str]()

    def window(self, path: Path) -> None:
        """Look at one window, and accept what is proposed."""
        self._number += 1
        now_s, loop, outcome = self._number * self._window_s, self._loop, self.outcome
        todo = loop.todo(self._number, outcome.loaded, now_s)
        if todo is None:
            return
        order = Order(todo, str(path), without_passwords(Config()), str(path.parent), {}, "")
        self._count(loop.take(todo, Judge(order).result(), now_s))
        proposal = loop.proposal
        if proposal is not None and proposal.stage in (Stage.BETTER, Stage.NOT_BETTER):
            outcome.effects[proposal.number] = _gained(proposal)
        if proposal is not None and proposal.stage is Stage.OPEN:
            outcome.proposed.append((self._number, proposal.sentence, list(proposal.causes)))
            decided = loop.decided(Step.ACCEPT, proposal.number)
            loop.adopt(decided, self._number)  # the window that follows begins after it
            outcome.loaded = {n: t.value for n, t in decided.terms.items()}

    def _count(self, notes: Sequence[Note]) -> None:
        for note in notes:
            verdict = str(note.fields.get("verdict", "failed"))
            if note.kind in ("look", "failed"):
                self._looks[verdict] += 1
            if note.kind == "confirmation":
                self._confirmations[verdict] += 1
        self.outcome.looks = dict(self._looks)
        self.outcome.confirmations = dict(self._confirmations)


def _gained(proposal: Proposal) -> list[float]:
    """Return the effect on the quantities that gained where it was confirmed."""
    names = [n for n, q in proposal.gain.items() if q.ci95 is not None and q.ci95[0] > 1.0]
    return [proposal.effect[n].ratio for n in names if n in proposal.effect]


def run(case: Case) -> Outcome:
    """Run one case."""
    robot = Robot(case)
    with tempfile.TemporaryDirectory() as name:
        for track in case.tracks:
            for path in cut(track, case.window_s, Path(name)):
                robot.window(path)
    return robot.outcome


def kinds(names: Sequence[str], scale: float, window_s: float, seed: int) -> Iterator[Case]:
    """Yield a case for every kind."""
    for k, name in enumerate(names):
        hidden = CAUSES[name].draw(np.random.default_rng([seed, k]), scale)
        yield Case("kinds", name, (Track(name, seed + k, {}, hidden),), window_s)


def back(names: Sequence[str], scale: float, window_s: float, seed: int) -> Iterator[Case]:
    """Yield cases whose cause goes again."""
    for k, name in enumerate(names):
        hidden = CAUSES[name].draw(np.random.default_rng([seed, k]), scale)
        tracks = (
            Track(f"{name}_1", seed + k, {}, hidden),
            Track(f"{name}_2", seed + 100 + k, hidden, {}),
        )
        yield Case("back", name, tracks, window_s)


def nulls(windows: int, window_s: float, seed: int) -> Iterator[Case]:
    """Yield cases without a change, of ten windows each."""
    for k in range(-(-windows // 10)):
        rng = np.random.default_rng([seed, k])
        floor = [{"rotation_gain": float(rng.normal(0.0, FLOOR))} for _ in range(2)]
        yield Case("null", str(k), (Track("null", seed + k, floor[0], floor[1], 10),), window_s)


def is_right(name: str, causes: Sequence[str]) -> bool:
    """Whether a proposal names a cause, or what no drive can tell from it."""
    twins = {other for pair in TWINS if name in pair for other in pair}
    return bool({name, *twins} & set(causes))


def report(outcomes: Sequence[Outcome], window_s: float) -> dict[str, Any]:
    """Return the rows of the table."""
    found: dict[str, Any] = {"window_s": window_s}
    of_kinds = [o for o in outcomes if o.row == "kinds"]
    if of_kinds:
        right = [o for o in of_kinds if _right_in_time(o)]
        wrong = [o for o in of_kinds if any(not is_right(o.name, c) for _, _, c in o.proposed)]
        effects = [e for o in right for each in o.effects.values() for e in each]
        found["kinds"] = {
            "of": len(of_kinds),
            "right": len(right),
            "wrong": len(wrong),
            "missed": [o.name for o in of_kinds if o not in right],
            "gap_smaller_median": round(median(effects), 2) if effects else None,
        }
    of_back = [o for o in outcomes if o.row == "back"]
    if of_back:
        undone = [o for o in of_back if len(o.proposed) >= 2 and not o.loaded]
        found["back"] = {"of": len(of_back), "taken_back": len(undone)}
    of_null = [o for o in outcomes if o.row == "null"]
    if of_null:
        found["null"] = _null(of_null, window_s)
    return found


def _right_in_time(outcome: Outcome) -> bool:
    if not outcome.proposed:
        return False
    window, _, causes = outcome.proposed[0]
    return BEFORE < window <= BEFORE + DEADLINE and is_right(outcome.name, causes)


def _null(outcomes: Sequence[Outcome], window_s: float) -> dict[str, Any]:
    looks = sum((Counter(o.looks) for o in outcomes), Counter[str]())
    confirmations = sum((Counter(o.confirmations) for o in outcomes), Counter[str]())
    n, named = looks.total(), looks["named"]
    tried, confirmed = confirmations.total(), confirmations["confirmed"]
    chance = Spending().confirmation(window_s)
    return {
        "windows": n,
        "looks": dict(looks),
        "named": named,
        "named_share_95": clopper_pearson(named, n),
        "confirmed": confirmed,
        "confirmed_share_95": clopper_pearson(confirmed, tried),
        "proposals": sum(len(o.proposed) for o in outcomes),
        "extrapolated_per_year": named / max(n, 1) * chance * YEAR_S / window_s,
    }


def main() -> int:
    """Run the rows that are asked for; print a line for each case, and the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.recalibration")
    parser.add_argument("--rows", nargs="+", default=["kinds", "back", "null"])
    parser.add_argument("--kinds", nargs="+", default=list(KINDS))
    parser.add_argument("--window-s", type=float, default=360.0)
    parser.add_argument("--scale", type=float, default=1.0, help="times the reference size")
    parser.add_argument("--nulls", type=int, default=1000, help="windows without a change")
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    how = (args.scale, args.window_s, args.seed)
    cases = [
        *(kinds(args.kinds, *how) if "kinds" in args.rows else ()),
        *(back(BACK, *how) if "back" in args.rows else ()),
        *(nulls(args.nulls, args.window_s, args.seed) if "null" in args.rows else ()),
    ]
    outcomes = []
    for _, outcome in in_processes(run, cases, args.jobs):
        outcomes.append(outcome)
        print(json.dumps(asdict(outcome)), flush=True)
    print(json.dumps(report(outcomes, args.window_s), indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())

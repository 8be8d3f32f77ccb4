"""Whether the model keeps up: a robot simulated by another program changes, and its twin follows.

Each row of the table covers several robots, each over several windows, all in virtual time. One
line per robot is appended to a file, so that an interrupted run continues where it stopped.

kinds
    A hidden cause appears in the middle of a window. Whether it, and nothing wrong, is proposed
    within three windows from that one; the gap once accepted, on a window not used for it.
back
    A cause appears and disappears: the second proposal takes the first back.
null
    Nothing changes but the floor, within its noise. How often something is named, and confirmed;
    both windows are from one track. The rate per year is extrapolated.
wake
    Wake latency of the daemon while a window is diagnosed beside it, on a quiet computer.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from statistics import median
from typing import Any, Final

import numpy as np
from hilserver_injector.causes import CAUSES, TWINS

from benchmarks import tune
from benchmarks.binomial import clopper_pearson
from benchmarks.diagnose_results import Results, sources
from benchmarks.recalibration_robot import Case, Drive, counts
from benchmarks.recalibration_robot import run as run_case
from benchmarks.recalibration_wake import wake
from hilserver.bench.report import Result
from hilserver.errors import FailedError
from hilserver.program.workers import in_processes
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
BACK: Final = (
    "rotation_gain",
    "gyro_bias",
    "actuation_delay",
    "nav_latency",
    "saturation_limit",
)
ROWS: Final = ("kinds", "back", "null")
WAKE: Final = "wake"
DEADLINE: Final = 3
"""Windows within which a cause must be proposed, counted from its appearance."""
FLOOR: Final = 0.001
"""Variation of the rotation gain between windows, from the floor: too small to be named."""
NULLS_OF_EACH: Final = 10
RESULTS: Final = Path("build/recalibration/results.jsonl")
Record = Mapping[str, Any]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the rows."""
    parser.add_argument(
        "--rows", nargs="+", default=[*ROWS, WAKE], choices=[*ROWS, WAKE]
    )
    parser.add_argument(
        "--kinds", nargs="+", default=list(KINDS), choices=sorted(CAUSES)
    )
    parser.add_argument("--window-s", type=float, default=360.0)
    parser.add_argument(
        "--scale", type=float, default=1.0, help="times the reference size"
    )
    parser.add_argument(
        "--nulls", type=int, default=1000, help="windows without a change"
    )
    parser.add_argument("--null-window-s", type=float, default=120.0)
    parser.add_argument("--measured-noise", action="store_true",
                        help="position noise from the recording in HIL_DATA_DIR")  # fmt: skip
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--jobs", type=int, default=2, help="worker processes")
    parser.add_argument("--resume", type=Path, default=RESULTS, metavar="FILE",
                        help=f"lines of results, default {RESULTS}")  # fmt: skip
    tune.add_arguments(parser)


def run(args: argparse.Namespace) -> list[Result]:
    """Run robots without a result; return the table."""
    if unfit := [n for n in args.kinds if CAUSES[n].kind != "drive"]:
        raise FailedError(f"--kinds: {unfit[0]} does not show in a drive; leave it out")
    own = ("recalibration", "recalibration_robot")
    results = Results(args.resume, of=sources(own, ("recalibration",)))
    asked = list(cases(args))
    missing = [case for case in asked if case.key not in results.records]
    print(f"{len(missing)} of {len(asked)} robots to go; lines in {args.resume}")
    with closing(in_processes(run_case, missing, args.jobs)) as found:
        for index, outcome in found:
            case = missing[index]
            results.add({"key": case.key} | asdict(case) | asdict(outcome))
            print(f"{case.key}: {outcome.seconds:g} s", flush=True)
    of_pacing = wake(args) if WAKE in args.rows else []
    return [*table([results.records[case.key] for case in asked]), *of_pacing]


def cases(args: argparse.Namespace) -> Iterator[Case]:
    """Yield the robots of the requested rows."""
    made = {"kinds": kinds, "back": back, "null": nulls}
    for row in args.rows:
        yield from made[row](args) if row in made else ()


def kinds(args: argparse.Namespace) -> Iterator[Case]:
    """Yield a robot for every kind of cause."""
    for name in args.kinds:
        hidden = drawn(name, args)
        drives = (Drive(1, {}), Drive(1, hidden, {}), Drive(3, hidden))
        seed = args.seed + KINDS.index(name) if name in KINDS else args.seed
        yield Case(
            "kinds", name, drives, args.window_s, seed, hidden, 2, args.measured_noise
        )


def back(args: argparse.Namespace) -> Iterator[Case]:
    """Yield robots whose cause disappears again."""
    for k, name in enumerate(BACK):
        hidden = drawn(name, args)
        drives = (Drive(1, {}), Drive(3, hidden), Drive(3, {}))
        seed = args.seed + 100 + k
        yield Case(
            "back", name, drives, args.window_s, seed, hidden, 2, args.measured_noise
        )


def nulls(args: argparse.Namespace) -> Iterator[Case]:
    """Yield robots without a change."""
    for k in range(-(-args.nulls // NULLS_OF_EACH)):
        floor = np.random.default_rng([args.seed, k]).normal(0.0, FLOOR, 2)
        before, after = ({"rotation_gain": float(gain)} for gain in floor)
        drives = (Drive(NULLS_OF_EACH, after, before),)
        yield Case("null", str(k), drives, args.null_window_s, args.seed + 200 + k,
                   measured_noise=args.measured_noise)  # fmt: skip


def drawn(name: str, args: argparse.Namespace) -> dict[str, float]:
    """Return a cause at its size, with random sign and shape."""
    rng = np.random.default_rng([args.seed, *name.encode()])
    return CAUSES[name].draw(rng, args.scale)


def is_right(name: str, terms: Mapping[str, Any]) -> bool:
    """Whether a patch has only a cause and its twins, which no drive can separate from it."""
    twins = {other for pair in TWINS if name in pair for other in pair}
    return bool(terms) and {term.partition(".")[0] for term in terms} <= {name, *twins}


def table(records: Sequence[Record]) -> list[Result]:
    """Return the rows of the contract."""
    rows = {row: [r for r in records if r["row"] == row] for row in ROWS}
    return [*_kinds(rows["kinds"]), *_back(rows["back"]), *_null(rows["null"])]


def _kinds(records: Sequence[Record]) -> Iterator[Result]:
    if not records:
        return
    right = [r for r in records if _in_time(r)]
    wrong = [
        r["name"]
        for r in records
        if not all(is_right(r["name"], p["terms"]) for p in r["proposed"])
    ]
    missed = [r["name"] for r in records if r not in right]
    yield Result("right within three windows", len(right), f"of {len(records)}", 11, "at least",
                 raw=missed)  # fmt: skip
    yield Result("robots with a wrong proposal", len(wrong), f"of {len(records)}", 0, "at most",
                 raw=wrong)  # fmt: skip
    effects = [ratio for r in right for one in r["effects"].values() for ratio in one]
    if effects:
        yield Result("gap before by after, median", median(effects), "x", 3, "at least")
    sizes = [s for r in right if (s := _size(r)) is not None]
    if sizes:
        yield Result(
            "error of the size, median", 100 * median(e for e, _ in sizes), "%"
        )
        yield Result(
            "intervals that hold the size", sum(h for _, h in sizes), f"of {len(sizes)}"
        )


def _in_time(r: Record) -> bool:
    if not r["proposed"]:
        return False
    first = r["proposed"][0]
    in_time = r["appears"] <= first["window"] < r["appears"] + DEADLINE
    return in_time and is_right(r["name"], first["terms"])


def _size(r: Record) -> tuple[float, bool] | None:
    """Return the final error relative to the size, and whether the interval has the truth."""
    name = next(iter(r["hidden"]))
    last = r["proposed"][-1]["terms"].get(name)
    if last is None:
        return None
    truth, (value, interval, _) = r["hidden"][name], last
    held = interval is not None and interval[0] <= truth <= interval[1]
    return abs(value - truth) / abs(truth), held


def _back(records: Sequence[Record]) -> Iterator[Result]:
    if records:
        undone = [r for r in records if len(r["proposed"]) >= 2 and not r["loaded"]]
        left = [r["name"] for r in records if r not in undone]
        yield Result("taken back", len(undone), f"of {len(records)}", len(records), "at least",
                     raw=left)  # fmt: skip


def _null(records: Sequence[Record]) -> Iterator[Result]:
    if not records:
        return
    looks, confirmations = counts(records, "looks"), counts(records, "confirmations")
    n, named, window_s = looks.total(), looks["named"], records[0]["window_s"]
    proposals = sum(len(r["proposed"]) for r in records)
    yield Result("proposals without a change", proposals, f"of {n}", 0, "at most")
    for what, k, of in (
        ("named without a change", named, n),
        ("confirmed of those", confirmations["confirmed"], confirmations.total()),
    ):
        low, high = clopper_pearson(k, of)
        yield Result(what, k, f"of {of}", raw=(low, high))
        yield Result(f"{what}, upper end of 95 %", 100 * high, "%")
    # The level of a confirmation is set; the rate of names is measured.
    chance = Spending().confirmation(window_s) * YEAR_S / window_s
    yield Result("false a year, extrapolated", named / n * chance, "", 1, "at most")
    upper = clopper_pearson(named, n)[1] * chance
    yield Result("its upper end of 95 %", upper, "")
    others = {
        verdict: k
        for verdict, k in looks.items()
        if verdict not in ("nothing", "named")
    }
    yield Result("other verdicts", sum(others.values()), f"of {n}", raw=others)

"""The observer: whether its intervals hold, how much it improves on alternatives, what it costs.

Robots with two hidden causes each are diagnosed, then driven again; the true pose is known every
millisecond. The navigation is silent for 60 s. The alternatives are the wheels alone without the
patch, and a filter with default covariances.
"""

import argparse
import time
from contextlib import closing
from dataclasses import asdict, fields
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from benchmarks.binomial import clopper_pearson
from benchmarks.diagnose_results import OWN, Results, sources
from benchmarks.observer_drives import Robot, Score, recipes, scored
from benchmarks.observer_recordings import measure
from hilserver.bench.report import Result
from hilserver.compiled import part
from hilserver.compiled.records import record_at
from hilserver.config.observer import constants_of
from hilserver.observer.filter import (
    add_position,
    add_yaw,
    close_moment,
    moment,
    open_moment,
)
from hilserver.observer.layout import N_FILTER
from hilserver.plant.layout import PARAMETERS
from hilserver.plant.packing import pack
from hilserver.plant.parameters import RobotParameters
from hilserver.program.workers import in_processes

STEPS, PERIOD_S = 2000, 0.01


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the kind and number of drives, and the folder where they are kept."""
    parser.add_argument(
        "--diagnoses", type=int, default=200, help="robots, each diagnosed once"
    )
    parser.add_argument("--drives", type=int, default=5, help="drives of each")
    parser.add_argument(
        "--jobs", type=int, default=2, help="worker processes; default 2"
    )
    parser.add_argument(
        "--keep", type=Path, default=Path("build/observer"),
        help="folder of diagnoses and drives: an interrupted row goes on from them",
    )  # fmt: skip
    parser.add_argument(
        "--undiagnosed", action="store_true",
        help="with --recordings: the observer knows what is configured, as its rivals do",
    )  # fmt: skip
    parser.add_argument(
        "--recordings", type=Path, metavar="DIR",
        help="instead: robots with motion capture, the navigation silent every other 20 s",
    )  # fmt: skip


def run(args: argparse.Namespace) -> list[Result]:
    """Drive and time; each drive adds a line to drives.jsonl in the folder."""
    if args.recordings is not None:
        undiagnosed = args.undiagnosed
        return measure(args.recordings, args.keep, args.jobs, undiagnosed=undiagnosed)
    return [*figures(_scores(args)), *costs()]


def _scores(args: argparse.Namespace) -> list[Score]:
    of = sources((*OWN, "observer_drives", "default_filter"), ("observer",))
    results = Results(args.keep / "drives.jsonl", of=of)
    robots = [
        Robot(key, recipe, args.drives, args.keep)
        for key, recipe in islice(recipes(), args.diagnoses)
    ]
    todo = [one for one in robots if not one.drives <= results.records.keys()]
    with closing(in_processes(scored, todo, args.jobs)) as found:
        for _, scores in found:
            for one in scores:
                if one.key not in results.records:
                    results.add(asdict(one))
    names = {field.name for field in fields(Score)}
    drives = [results.records[key] for one in robots for key in sorted(one.drives)]
    return [Score(**{n: drive[n] for n in names}) for drive in drives]


def figures(scores: list[Score]) -> list[Result]:
    """Return the rows of the contract."""
    if not scores:
        return []
    n = len(scores)
    nees, cut = np.array([s.nees for s in scores]), np.array([s.cut for s in scores])
    inside = int((nees < chi2.ppf(0.95, 3)).sum())
    ended = int((cut < chi2.ppf(0.95, 2)).sum())
    ours = float(np.median([s.observer_m for s in scores]))
    wheels = float(np.median([s.reckoning_m for s in scores]))
    rival = float(np.median([s.default_m for s in scores]))
    return [
        Result("NEES of the pose, mean", float(nees.mean()), "1", 3.0, "three states"),
        Result(
            "NEES of the pose, median",
            float(np.median(nees)),
            "1",
            2.366,
            "chi-squared",
        ),
        _share("pose inside 95 %", inside, n),
        _share("after 60 s alone: inside 95 %", ended, n),
        Result(
            "error then", ours, "m", wheels, "wheels alone, unpatched", wheels / ours
        ),
        Result("error then", ours, "m", rival, "default covariances", rival / ours),
    ]


def _share(name: str, count: int, n: int) -> Result:
    return Result(name, count / n, "1", 0.95, "wanted", raw=clopper_pearson(count, n))


@part
def _steps(
    numbers: Any, c: Any, f: Any, begin: int, n: int, every: int, late: float
) -> None:
    p = record_at(numbers, 0, PARAMETERS)
    for k in range(begin, begin + n):
        time_s = k * PERIOD_S
        open_moment(c, f, time_s, (5.0, -4.0, 0.0, 0.0, 0.0))
        if k % every == 0:
            add_yaw(f, time_s - late, moment(f, 0).estimate[2])
            add_position(f, time_s - late, 0.0, 0.0)
        close_moment(p, c, f)


def costs() -> list[Result]:
    """Return the time of a step, alone and with late samples, and of a copy of the state."""
    robot = RobotParameters()
    p, c, results = pack(robot), constants_of(robot, None, 1000), []
    for name, every, late in (
        ("a step without samples", STEPS + 1, 0.0),
        ("a step with a sample 100 ms late", 1, 0.1),
        ("a step with a sample 1 s late", 1, 0.99),
    ):
        f, best = np.zeros(N_FILTER), np.inf
        _steps(p.numbers, c, f, 0, 200, every, late)
        for block in range(5):
            began = time.thread_time_ns()
            _steps(p.numbers, c, f, 200 + block * STEPS, STEPS, every, late)
            best = min(best, (time.thread_time_ns() - began) / STEPS * 1e-3)
        results.append(Result(name, best, "us"))
    f, other = np.zeros(N_FILTER), np.zeros(N_FILTER)
    began = time.thread_time_ns()
    for _ in range(100):
        other[:] = f
    copied_us = (time.thread_time_ns() - began) * 1e-5
    return [
        *results,
        Result(f"a copy of its {N_FILTER * 8 // 1000} kB", copied_us, "us"),
    ]

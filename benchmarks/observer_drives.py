"""Drives of the injector for the observer: diagnosed once, then driven again, with dense truth."""

from collections.abc import Callable, Iterator, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from hilserver_injector import Recipe, make
from hilserver_injector.cases import pairs

from benchmarks.default_filter import default_filter
from benchmarks.diagnose_results import sources
from benchmarks.diagnose_worker import measured
from hilserver.arrays import Array
from hilserver.config.observer import constants_of, load_found
from hilserver.config.patch import load_patch
from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble, assemble_config
from hilserver.diagnosis.engine import diagnose
from hilserver.diagnosis.output import documents
from hilserver.measured.data import MeasuredLog
from hilserver.measured.observed import series_of
from hilserver.observer.layout import YAW
from hilserver.observer.offline import GYRO, MeasuredSeries, run
from hilserver.plant.packing import pack
from hilserver.plant.parameters import RobotParameters
from hilserver.program.progress import Progress

DRIVE_S: Final = 150.0
CUT_S: Final = (80.0, 140.0)
"""Interval in which the navigation is silent."""
ASKED_S: Final = (20.0, 80.0)
"""Interval in which one instant is drawn."""


@dataclass(frozen=True)
class Robot:
    """A robot that is diagnosed once, and the number of drives that follow."""

    key: str
    recipe: Recipe
    n_drives: int
    keep: Path

    @property
    def drives(self) -> Set[str]:
        """Keys of its drives."""
        return {f"{self.key}/{number}" for number in range(self.n_drives)}


@dataclass(frozen=True)
class Score:
    """Results of one drive."""

    key: str
    nees: float  # NEES of the pose at a random instant
    cut: float  # NEES of the position at the end of the cut
    observer_m: float  # errors of the position there
    reckoning_m: float  # of the wheels alone, unpatched
    default_m: float


def recipes() -> Iterator[tuple[str, Recipe]]:
    """Yield driving robots with two hidden causes each, drawn by seed, without end."""
    seed = 0
    while True:
        for case in pairs(seed):
            if case.recipe.kind == "drive":
                yield case.key.replace("/", "_"), case.recipe
        seed += 1


@dataclass(frozen=True)
class Known:
    """What a diagnosis has found out about a robot."""

    robot: RobotParameters  # with its patch
    constants: Array  # of its filter
    late_s: float = 0.0  # delay of the navigation's time stamps


def diagnosed(
    folder: Path, log: Callable[[], MeasuredLog], config: Config, jobs: int = 1
) -> Known:
    """Return what is known about a robot.

    Parameters
    ----------
    folder : Path
        Contains the diagnosis; otherwise it is written there.
    """
    if not (folder / "findings.json").exists():
        folder.mkdir(parents=True, exist_ok=True)
        with Progress(lambda: "stopped before it was measured") as progress:
            assembly = assemble_config(config)
            result = diagnose(log(), assembly, jobs=jobs, progress=progress)
        for name, text in documents(result).items():
            if name.endswith((".json", ".yaml")):
                (folder / name).write_text(text, encoding="utf-8")
    path = folder / "model_patch.yaml"
    patch = load_patch(path) if path.exists() else None
    robot, found = (
        assemble_config(config, None, patch).robot,
        load_found(folder / "findings.json"),
    )
    return Known(robot, constants_of(robot, found), found.nav_late_s)


def without_navigation(
    series: MeasuredSeries, cut_s: tuple[float, float]
) -> MeasuredSeries:
    """Return a series without navigation in an interval."""
    s = series.samples
    silent = (s[:, 0] != GYRO) & (s[:, 1] >= cut_s[0]) & (s[:, 1] < cut_s[1])
    return MeasuredSeries(series.wheels, s[~silent])


def angle(values: Array) -> Array:
    """Return angles within -pi .. pi."""
    return np.asarray(np.angle(np.exp(1j * values)))


def scored(one: Robot) -> list[Score]:
    """Diagnose a robot, and return the results of its drives."""
    recipe, folder = one.recipe, one.keep / sources() / one.key
    known = diagnosed(folder, lambda: measured(make(recipe)[0]), Config())
    return [score(one.key, recipe, known, number) for number in range(one.n_drives)]


def score(key: str, recipe: Recipe, known: Known, number: int) -> Score:
    """Return the results of drive `number` of a diagnosed robot."""
    again = replace(recipe, seed=recipe.seed + 1000 * (number + 1), duration_s=DRIVE_S)
    table, truth = make(again)
    log = measured(table)
    series = without_navigation(series_of(log, 0, known.robot, known.late_s), CUT_S)
    course, t = run(pack(known.robot), known.constants, series), series.wheels[:, 0]
    true = np.stack(
        [np.interp(t, truth.dense[:, 0], truth.dense[:, k]) for k in (1, 2, 3)], axis=1
    )
    error = course.estimate[:, :3] - true
    error[:, YAW] = angle(error[:, YAW])
    rng = np.random.default_rng([recipe.seed, number])
    at, end = (
        int(np.searchsorted(t, when)) for when in (rng.uniform(*ASKED_S), CUT_S[1])
    )
    end -= 1  # the last moment before the navigation returns
    nees, cut = (
        float(
            error[k, :n] @ np.linalg.solve(course.covariance[k, :n, :n], error[k, :n])
        )
        for k, n in ((at, 3), (end, 2))
    )
    plain = assemble(None).robot
    base = pack(plain)
    raw = without_navigation(series_of(log, 0, plain), CUT_S)
    wheels = run(
        base, constants_of(plain, None), MeasuredSeries(raw.wheels, np.zeros((0, 4)))
    ).estimate
    begin = int(np.searchsorted(t, CUT_S[0]))
    turn = true[begin, 2] - wheels[begin, 2]
    cos, sin = np.cos(turn), np.sin(turn)
    away = np.array([[cos, -sin], [sin, cos]]) @ (wheels[end, :2] - wheels[begin, :2])
    rival = default_filter(base, raw)
    return Score(
        key=f"{key}/{number}",
        nees=nees,
        cut=cut,
        observer_m=float(np.hypot(*error[end, :2])),
        reckoning_m=float(np.hypot(*(true[begin, :2] + away - true[end, :2]))),
        default_m=float(np.hypot(*(rival[end, :2] - true[end, :2]))),
    )

"""Logs of the injector with their diagnosis; each is made once for all tests of a run."""

from dataclasses import replace
from functools import cache

from hilserver_injector import Recipe, make, nothing, single

from benchmarks.diagnose_worker import measured
from hilserver.daemon.assembly import Assembly, assemble
from hilserver.diagnosis.engine import diagnose
from hilserver.diagnosis.regression.stages import Prepared, prepare, stages_of
from hilserver.diagnosis.schema.evidence import Diagnosis
from hilserver.plant.parameters import RobotParameters


@cache
def assembly() -> Assembly:
    """Return the configured plant, as it is without a configuration file."""
    return assemble(None)


def recipe(cause: str, seed: int, duration_s: float) -> Recipe:
    """Return the recipe of a log; `cause` may be ``nothing drive`` or ``nothing bench``."""
    first, _, kind = cause.partition(" ")
    made = nothing(kind, seed) if first == "nothing" else single(cause, seed)
    return replace(made, duration_s=duration_s)


def judged(made: Recipe, *, jobs: int = 1, seed: int = 0) -> Diagnosis:
    """Make a log and diagnose it."""
    return diagnose(measured(make(made)[0]), assembly(), seed=seed, jobs=jobs)


@cache
def diagnosis(cause: str, seed: int, duration_s: float) -> Diagnosis:
    """Return the diagnosis of a log with one cause at its reference size, or none."""
    return judged(recipe(cause, seed, duration_s))


def prepared(made: Recipe, robot: RobotParameters) -> dict[str, Prepared]:
    """Make a log and return its stages, ready to be judged: hundreds of megabytes if it is long."""
    stages = stages_of(measured(make(made)[0]), robot)
    found = {
        name: prepare(stage, 1, lambda *_: None)[0] for name, stage in stages.items()
    }
    return {name: p for name, p in found.items() if p is not None}

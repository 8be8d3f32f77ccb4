"""What a diagnosis of ten minutes at 50 Hz costs: CPU seconds, with and without the nested gain."""

import time
from collections.abc import Mapping
from typing import Final

from hilserver_injector import Recipe, make

from benchmarks.diagnose_worker import measured
from hilserver.bench.report import Result
from hilserver.daemon.assembly import assemble
from hilserver.diagnosis.engine import HALVES, diagnose
from hilserver.diagnosis.memory import reuse_memory
from hilserver.diagnosis.output import documents

LENGTH_S: Final = 600.0
HIDDEN: Final[Mapping[str, Mapping[str, float]]] = {
    "no effect": {},
    "one effect": {"rotation_gain": 0.03},
    "six effects": {
        "rotation_gain": 0.03,
        "icr_offset": 0.06,
        "longitudinal_slip": 0.12,
        "nav_latency": 0.1,
        "gyro_bias": 0.006,
        "actuation_delay": 0.04,
    },
}


def time_spent(duration_s: float | None, jobs: int) -> list[Result]:
    """Return the CPU time of warm diagnoses, documents included; of other lengths if requested."""
    reuse_memory()  # as the command does
    _spent_s({}, 30.0, jobs)  # compiles
    found = []
    for name, causes in HIDDEN.items():
        parts = _spent_s(causes, duration_s or LENGTH_S, jobs)
        total = sum(parts.values())
        found += [
            Result(f"{name}, nested gain", total, "s", raw=parts),
            Result(f"{name}, without", total - parts.get(HALVES, 0.0), "s"),
        ]
    return found


def _spent_s(
    causes: Mapping[str, float], length_s: float, jobs: int
) -> dict[str, float]:
    """Return the CPU time of each part of a diagnosis, by its reported stage."""
    recipe = Recipe(seed=1, causes=causes, duration_s=length_s)
    log, assembly = measured(make(recipe)[0]), assemble(None)
    spent: dict[str, float] = {}
    doing, since = "", time.process_time()

    def report(text: str, share: float) -> None:
        del share
        nonlocal doing, since
        now = time.process_time()
        spent[doing] = spent.get(doing, 0.0) + now - since
        doing, since = text.partition(": effect of")[0], now

    documents(diagnose(log, assembly, jobs=jobs, progress=report))
    report("", 1.0)
    return spent

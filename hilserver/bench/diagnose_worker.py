"""One case of the campaign in a worker process: make the log, diagnose it, open the truth."""

import time
from dataclasses import replace
from functools import cache
from importlib import import_module
from typing import Any, Protocol

import numpy as np
from hilserver_injector import Recipe, Table, make
from hilserver_injector.cases import Case

from hilserver.assembly import Assembly, assemble
from hilserver.bench.diagnose_scoring import Score, score
from hilserver.diagnosis.data import Channel, MeasuredLog, Source, Span
from hilserver.diagnosis.evidence import Diagnosis


class Diagnose(Protocol):
    """The engine, as the campaign calls it."""

    def __call__(
        self, log: MeasuredLog, assembly: Assembly, *, seed: int, jobs: int, progress: None
    ) -> Diagnosis:
        """Return the diagnosis of a log."""


@cache
def _engine() -> tuple[Diagnose, Assembly]:
    engine: Diagnose = import_module("hilserver.diagnosis.engine").diagnose
    return engine, assemble(None)


def measured(table: Table, recipe: Recipe) -> MeasuredLog:
    """Return the log as the reader would: empty cells are no samples."""
    channels = {}
    for name, values in table.columns.items():
        there = np.isfinite(values)
        span = np.zeros(int(there.sum()), dtype=np.int64)
        channels[name] = Channel(table.t_s[there], values[there], span)
    span_of_log = Span(0, None, float(table.t_s[0]), float(table.t_s[-1]))
    source = Source(f"{recipe.kind}-{recipe.seed}.csv", "0" * 64)
    return MeasuredLog((source,), channels, (span_of_log,))


def work(case: Case) -> dict[str, Any]:
    """Return the record of one case: plain data, one line of the results file.

    An engine that breaks on a log is a result too: outcome ``crashed``.
    """
    engine, assembly = _engine()
    table, _ = make(case.recipe)
    log = measured(table, case.recipe)
    record = {
        "key": case.key,
        "group": case.group,
        "name": case.name,
        "seed": case.recipe.seed,
        "kind": case.recipe.kind,
    }
    begin = time.perf_counter()
    try:
        found = engine(log, assembly, seed=case.recipe.seed, jobs=1, progress=None).findings
        result = score(case, found)
        smallest = {row.cause: row.size for row in found.smallest_detectable}
    except Exception as error:  # noqa: BLE001 (the campaign goes on)
        result, smallest = Score(outcome="crashed", found=[f"{type(error).__name__}: {error}"]), {}
    seconds = time.perf_counter() - begin
    return record | {"seconds": seconds, "smallest": smallest} | result.as_json()


def shortened(case: Case, duration_s: float | None) -> Case:
    """Return the case with a log of another duration; for a quick look, not for the table."""
    if duration_s is None:
        return case
    return replace(case, recipe=replace(case.recipe, duration_s=duration_s))

"""One case of the campaign in a worker process: make the log, diagnose it, open the truth."""

import time
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from hilserver_injector import Recipe, Table, make
from hilserver_injector.cases import Case

from benchmarks.diagnose_scoring import Score, score
from hilserver.daemon.assembly import Assembly, assemble
from hilserver.diagnosis.schema.evidence import Diagnosis
from hilserver.diagnosis.schema.findings import Findings
from hilserver.measured.data import Channel, LogSource, MeasuredLog, Span
from hilserver.measured.reading import read_measured
from hilserver.scenarios import scenario
from reference.scenarios.judging import causes_of, judge

ENGINE_SEED: Final = 0
"""Of the diagnosis's own draws, as the command has it: it never learns the seed of a log."""


class Diagnose(Protocol):
    """The engine, as the campaign calls it."""

    def __call__(
        self,
        log: MeasuredLog,
        assembly: Assembly,
        *,
        seed: int,
        jobs: int,
        progress: None,
    ) -> Diagnosis:
        """Return the diagnosis of a log."""


@cache
def _engine() -> tuple[Diagnose, Assembly]:
    engine: Diagnose = import_module("hilserver.diagnosis.engine").diagnose
    return engine, assemble(None)


def measured(table: Table) -> MeasuredLog:
    """Return the log as the reader would: empty cells are not samples.

    It says nothing of what it was made from: every log has the same name.
    """
    channels = {}
    for name, values in table.columns.items():
        there = np.isfinite(values)
        span = np.zeros(int(there.sum()), dtype=np.int64)
        channels[name] = Channel(table.t_s[there], values[there], span)
    span_of_log = Span(0, None, float(table.t_s[0]), float(table.t_s[-1]))
    source = LogSource("log.csv", "0" * 64)
    return MeasuredLog((source,), channels, (span_of_log,))


@dataclass(frozen=True, slots=True)
class Staged:
    """One drawing of a scenario, as a case of the campaign."""

    name: str
    seed: int
    group: str = "scenario"
    kind: str = "scenario"

    @property
    def key(self) -> str:
        """Its name among all cases of a campaign."""
        return f"{self.group}/{self.name}/{self.seed}"


DRAWN: Final = 2.0 / 3.0
"""Share of a recording's blocks in a drawing; a block drawn twice would predict itself."""


@dataclass(frozen=True, slots=True)
class Drawn:
    """Two thirds of the blocks of a recording, as a case of the campaign: its truth is unknown."""

    mapping: str
    file: Path
    seed: int
    group: str = "recording"
    kind: str = "recording"

    @property
    def name(self) -> str:
        """Name of the recording."""
        return self.file.stem

    @property
    def key(self) -> str:
        """Its name among all cases of a campaign."""
        return f"{self.group}/{self.name}/{self.seed}"

    def log(self) -> MeasuredLog:
        """Return the drawn blocks (or segments, if the recording has no blocks)."""
        whole = read_measured([self.file], self.mapping)
        blocks = np.array(
            [k if s.block is None else s.block for k, s in enumerate(whole.spans)]
        )
        rng = np.random.default_rng([self.seed, zlib.crc32(self.name.encode())])
        names = np.unique(blocks)
        drawn = rng.choice(names, size=max(round(DRAWN * len(names)), 1), replace=False)
        kept = np.flatnonzero(np.isin(blocks, drawn))
        channels = {}
        for name, channel in whole.channels.items():
            rows = np.isin(channel.span, kept)
            span = np.searchsorted(kept, channel.span[rows])
            channels[name] = Channel(channel.t_s[rows], channel.values[rows], span)
        return replace(
            whole, channels=channels, spans=tuple(whole.spans[k] for k in kept)
        )


def work(case: Case | Staged | Drawn, *, with_rivals: bool = False) -> dict[str, Any]:
    """Return the record of one case: plain data, one line of the results file.

    An engine that fails on a log is a result too: outcome ``crashed``.

    Parameters
    ----------
    with_rivals : bool
        Also record the answers of rivals.
    """
    seed, kind = (
        (case.recipe.seed, case.recipe.kind)
        if isinstance(case, Case)
        else (case.seed, case.kind)
    )
    record = {
        "key": case.key, "group": case.group, "name": case.name, "seed": seed, "kind": kind,
    }  # fmt: skip
    logs, against = _logs(case)
    begin, smallest, gain, worse = time.perf_counter(), {}, {}, []
    try:
        diagnosis = _diagnosis(logs, against)
        found, worse = diagnosis.findings, made_worse(diagnosis)
        result = _judged(case, found)
        gain = {quantity: one.ratio for quantity, one in found.total_gain.items()}
        if case.group == "null":
            smallest = {row.cause: row.size for row in found.smallest_detectable}
    except Exception as error:  # noqa: BLE001 (the campaign goes on)
        result = Score(outcome="crashed", found=[f"{type(error).__name__}: {error}"])
    seconds = time.perf_counter() - begin
    if with_rivals and isinstance(case, Case):
        rivals = import_module("benchmarks.campaign_rivals")
        record |= rivals.answers(case, logs, assemble(None).robot)
    record |= {"seconds": seconds, "smallest": smallest, "gain": gain, "worse": worse}
    return record | result.as_json()


def made_worse(diagnosis: Diagnosis) -> list[str]:
    """Return the reported quantities that a patch makes worse: whole intervals below 1."""
    if not diagnosis.evidence.extension:
        return []
    gains = diagnosis.findings.total_gain
    return [
        key
        for key, gain in gains.items()
        if gain.ci95 is not None and gain.ci95[1] < 1.0
    ]


def _logs(case: Case | Staged | Drawn) -> tuple[MeasuredLog, MeasuredLog | None]:
    """Return the log of a case and, if two are to be compared, the other one."""
    if isinstance(case, Drawn):
        return case.log(), None
    if not isinstance(case, Staged):
        return measured(make(case.recipe)[0]), None
    drive = scenario(case.name).draw(case.seed)
    return _pooled(drive.logs), _pooled(drive.against) if drive.against else None


def _diagnosis(log: MeasuredLog, against: MeasuredLog | None) -> Diagnosis:
    engine, assembly = _engine()
    if against is None:
        return engine(log, assembly, seed=ENGINE_SEED, jobs=1, progress=None)
    compare = import_module("hilserver.diagnosis.engine").compare
    how: Any = {"seed": ENGINE_SEED, "jobs": 1, "progress": None}
    compared: Diagnosis = compare(log, against, assembly, **how)
    return compared


def _findings(log: MeasuredLog, against: MeasuredLog | None) -> Findings:
    return _diagnosis(log, against).findings


def _pooled(recipes: Mapping[str, Recipe]) -> MeasuredLog:
    """Return several logs of one machine as one, as the reader does."""
    logs = [measured(make(recipe)[0]) for recipe in recipes.values()]
    channels = {}
    for name in logs[0].channels:
        parts = [log[name] for log in logs]
        channels[name] = Channel(
            np.concatenate([part.t_s for part in parts]),
            np.concatenate([part.values for part in parts]),
            np.concatenate([part.span + k for k, part in enumerate(parts)]),
        )
    spans = tuple(replace(log.spans[0], number=k) for k, log in enumerate(logs))
    return MeasuredLog(tuple(log.sources[0] for log in logs), channels, spans)


def _judged(case: Case | Staged | Drawn, found: Findings) -> Score:
    if isinstance(case, Case):
        return score(case, found)
    if isinstance(case, Drawn):
        said = [f"{f.verdict}:{'|'.join(f.causes)}" for f in found.findings]
        return Score("unscored", found=said)
    verdict = judge(scenario(case.name).draw(case.seed).expectation, found)
    said = [f"{f.verdict}:{'|'.join(sorted(causes_of(f)))}" for f in found.findings]
    return Score(
        "right" if verdict.right else "missed", wrong=list(verdict.wrong), found=said
    )


def changed(case: Case, duration_s: float | None, measured_noise: bool) -> Case:
    """Return the case with a log of another duration, or with the position noise of a recording."""
    recipe = case.recipe
    if duration_s is not None:
        recipe = replace(recipe, duration_s=duration_s)
    if measured_noise:
        recipe = replace(recipe, noise=replace(recipe.noise, measured_position=True))
    return replace(case, recipe=recipe)

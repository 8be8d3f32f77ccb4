"""Do two sets of logs differ, and in what? The unit is the run where there are several.

Every cause is estimated in both sets, at the model that both share. The difference is judged
against the scatter between blocks and, with two runs or more on each side, between runs: one run's
own precision says nothing about the next run.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hilserver import __version__
from hilserver.daemon.assembly import Assembly
from hilserver.diagnosis.checks import check
from hilserver.diagnosis.checks.frame import untold, without_kinematics
from hilserver.diagnosis.checks.standstill import stood_still, too_little_motion
from hilserver.diagnosis.compare.differences import Difference, differences_of
from hilserver.diagnosis.compare.differing import difference_findings, smallest_differences
from hilserver.diagnosis.decide.selection import select
from hilserver.diagnosis.engine import silent
from hilserver.diagnosis.examine import Tell
from hilserver.diagnosis.memory import one_blas_thread
from hilserver.diagnosis.regression.problem import Point
from hilserver.diagnosis.regression.stages import prepare_all
from hilserver.diagnosis.replay.judgeable import vocabulary_reasons
from hilserver.diagnosis.schema.evidence import Diagnosis, Evidence
from hilserver.diagnosis.schema.findings import (
    Findings,
    LogFile,
    NotJudged,
    Overall,
)
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.measured.machine import machine

Array = NDArray[np.float64]


def together(a: MeasuredLog, b: MeasuredLog) -> tuple[MeasuredLog, NDArray[np.bool_]]:
    """Return both sets as one log, and which of its spans belong to the second."""
    shift = len(a.spans)
    channels = {}
    for name in a.channels.keys() & b.channels.keys():
        x, y = a[name], b[name]
        channels[name] = Channel(
            np.concatenate([x.t_s, y.t_s]),
            np.concatenate([x.values, y.values]),
            np.concatenate([x.span, y.span + shift]),
        )
    spans = (*a.spans, *(replace(s, number=s.number + shift, block=None) for s in b.spans))
    spans = tuple(replace(s, block=None) for s in spans)
    second = np.arange(len(spans)) >= shift
    log = replace(a, sources=(*a.sources, *b.sources), channels=channels, spans=spans)
    return log, second


@one_blas_thread
def compare(
    log: MeasuredLog,
    other: MeasuredLog,
    assembly: Assembly,
    *,
    seed: int = 0,
    jobs: int = 2,
    progress: Tell | None = None,
) -> Diagnosis:
    """Judge whether `other` differs from `log`, and in what.

    Returns
    -------
    Diagnosis
        Verdict ``differs`` or ``no_difference``; parameters ``<cause>.a`` and ``<cause>.b`` are the
        values of both sets, ``<cause>`` their difference.
    """
    tell = progress or silent
    robot = machine(log, assembly.robot)
    both = [check(one, robot) for one in (log, other)]
    faults = [finding for checked in both for finding in checked.findings]
    cleaned = [checked.log for checked in both]
    still = [too_little_motion()] if any(map(stood_still, cleaned)) else []
    reasons_untold = [why for one in cleaned if (why := untold(one, robot)) is not None]
    if reasons_untold:
        cleaned = [without_kinematics(one, reasons_untold[0]) for one in cleaned]
    pooled, second = together(*cleaned)
    prepared, reasons = prepare_all(
        pooled, robot, jobs, tell, lost_setpoints=any(checked.lost_setpoints for checked in both)
    )
    runs = run_of_spans(cleaned)
    differences: list[Difference] = []
    rng, scores = (
        np.random.default_rng(seed),
        {n: p.library.scores(p.base) for n, p in prepared.items()},
    )
    points: dict[str, Point] = {}
    for name, p in prepared.items():
        beside = [s for n, s in scores.items() if n != name]
        points[name] = select(p.problem, p.library, p.base, rng, jobs, beside).point
        differences += differences_of(name, p, points[name], second, runs)
    count = max(len({d.candidate.label for d in differences}), 1)
    differences = [replace(d, p=min(d.p * count, 1.0)) for d in differences]
    found = difference_findings(differences, prepared, points)
    detectable = smallest_differences(differences, count)
    findings = Findings(
        verdict=Overall.DIFFERS if found else Overall.NO_DIFFERENCE,
        logs=tuple(LogFile(file=s.file, sha256=s.sha256) for s in pooled.sources),
        seed=seed,
        version=__version__,
        config_sha256=assembly.config.sha256,
        findings=(*faults, *found, *still),
        smallest_detectable=detectable,
        not_judged=tuple(
            NotJudged(cause=c, reason=r)
            for c, r in vocabulary_reasons(
                {d.candidate.cause for d in differences}, reasons, set(prepared)
            ).items()
        ),
        notices=tuple(note for one in cleaned for note in one.notices),
    )
    return Diagnosis(findings, Evidence())


def run_of_spans(logs: Sequence[MeasuredLog]) -> NDArray[np.int64]:
    """Return the run that every span of the pooled log belongs to: its file.

    A set of one file with several segments counts every block of its own as a run, every segment
    where it has none.
    """
    runs: list[int] = []
    for log in logs:
        begin = max(runs, default=-1) + 1
        blocks = [s.block for s in log.spans]
        if len(log.sources) in (0, 1) and None not in blocks and len(set(blocks)) > 1:
            number = {block: i for i, block in enumerate(dict.fromkeys(blocks))}
            runs += [begin + number[block] for block in blocks]
        elif len(log.sources) in (0, 1) or len(log.sources) != len(log.spans):
            runs += [begin + i for i in range(len(log.spans))]
        else:
            runs += [begin + i for i in range(len(log.sources))]
    return np.array(runs, dtype=np.int64)

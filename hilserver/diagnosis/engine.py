"""A whole diagnosis: from measured data to findings, with the evidence behind them."""

import time
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from hilserver import __version__
from hilserver.daemon.assembly import Assembly
from hilserver.diagnosis.checks import check
from hilserver.diagnosis.checks.standstill import at_rest, stood_still, too_little_motion
from hilserver.diagnosis.decide.settling import Judged
from hilserver.diagnosis.examine import (
    Tell,
    beside,
    decisions_of,
    examine,
    noise_of_all,
    smallest_of,
)
from hilserver.diagnosis.findings.ceiling import ceilings
from hilserver.diagnosis.findings.estimate import estimate_of, joint
from hilserver.diagnosis.findings.explain import of_two_wheels
from hilserver.diagnosis.findings.nested import honest, judged_by_halves, predicts
from hilserver.diagnosis.findings.other_logs import gain_on
from hilserver.diagnosis.findings.outcome import extension, named, worsened
from hilserver.diagnosis.findings.worth import Explained, with_worth
from hilserver.diagnosis.memory import one_blas_thread
from hilserver.diagnosis.replay.judgeable import vocabulary_reasons
from hilserver.diagnosis.replay.model import Fitted, Model
from hilserver.diagnosis.report.showing import Shown, evidence
from hilserver.diagnosis.schema.evidence import Diagnosis
from hilserver.diagnosis.schema.findings import (
    Finding,
    Findings,
    LogFile,
    NotJudged,
    overall,
)
from hilserver.measured.data import MeasuredLog
from hilserver.plant.parameters import RobotParameters

Array = NDArray[np.float64]

HORIZON_S = 5.0
CEILING_DIGITS = 5
"""The rest of a ceiling hangs on how many threads share its large products."""


def silent(text: str, share: float) -> None:
    """Tell nobody."""
    del text, share


def diagnose(
    log: MeasuredLog,
    assembly: Assembly,
    *,
    seed: int = 0,
    jobs: int = 2,
    progress: Tell | None = None,
    test: MeasuredLog | None = None,
) -> Diagnosis:
    """Judge measured data of the machine that a configuration describes; see `judge`."""
    return judge(
        log,
        assembly.robot,
        config_sha256=assembly.config.sha256,
        seed=seed,
        jobs=jobs,
        progress=progress,
        test=test,
    )


@one_blas_thread
def judge(
    log: MeasuredLog,
    robot: RobotParameters,
    *,
    config_sha256: str = "",
    seed: int = 0,
    jobs: int = 2,
    horizon_s: float = HORIZON_S,
    progress: Tell | None = None,
    test: MeasuredLog | None = None,
) -> Diagnosis:
    """Judge measured data of one machine.

    Parameters
    ----------
    log : MeasuredLog
    robot : RobotParameters
        The configured plant, the base of all figures.
    seed : int
        Of sign flips and bootstrap; equal seeds give equal findings.
    jobs : int
        Threads; the findings do not depend on it.
    horizon_s : float
        Length of the free runs for which the gain is reported.
    progress : callable, optional
        Called with what is being done and its share.
    test : MeasuredLog, optional
        Other logs of the machine: the total gain is measured on these, and nothing else is.
    """
    started = time.perf_counter()
    timings: dict[str, float] = {}

    def lap(name: str) -> None:
        spent_s = time.perf_counter() - started - sum(timings.values())
        timings[name] = timings.get(name, 0.0) + spent_s

    tell = progress or silent
    rng = np.random.default_rng(seed)
    examined = examine(log, robot, rng, jobs, tell, lap)
    log, robot, judged = examined.log, examined.robot, examined.judged
    found = list(examined.checked.findings)
    fitted: dict[int, Fitted] = {}
    for j in judged.values():
        fitted |= _findings(j, found)
    lap("structure")
    tell("measuring the gain", 0.0)
    before, wholes, patched = _explained(judged, seed, jobs)
    own, of_patch = (
        {stage: whole.gains(whole.before, horizon_s, rng) for stage, whole in some.items()}
        for some in (wholes, patched)
    )
    totals = {key: gain for of_stage in own.values() for key, gain in of_stage.items()}
    notices = log.notices
    if test is not None:
        other = check(test, robot).log
        totals, of_patch[""] = (
            gain_on(other, robot, models, horizon_s, rng)
            for models in (
                {stage: j.whole.model for stage, j in judged.items()},
                {stage: j.point.model for stage, j in judged.items()},
            )
        )
        files = ", ".join(s.file for s in test.sources)
        notices = (*notices, *test.notices, f"the gain was measured on other logs: {files}")
    estimates = {stage: estimate_of(j.prepared.problem, j.point) for stage, j in judged.items()}
    for i, f in fitted.items():
        stage = f.candidate.stage
        index = judged[stage].point.model.fitted.index(f)
        only = own[stage] if judged[stage].whole is judged[stage].point else None
        found[i] = with_worth(
            found[i], index, wholes[stage], estimates[stage], horizon_s, rng, only
        )
    refusal = worsened(*of_patch.values())
    if refusal is not None:
        notices = (*notices, refusal)
    ceiling = _ceilings(judged, before, horizon_s, rng)
    sizes, unseen = smallest_of(judged, rng)
    if stood_still(log):
        sizes, unseen = at_rest(sizes, unseen)
        found.append(too_little_motion())
    lap("gain")
    if robot.wheelbase_m is None:
        found = [of_two_wheels(finding) for finding in found]
    judged_causes = {d.cause for d in sizes} | {c for f in found for c in f.causes}
    reasons = vocabulary_reasons(judged_causes, examined.reasons, set(judged))
    findings = Findings(
        verdict=overall(found, is_judged=bool(judged)),
        logs=tuple(LogFile(file=s.file, sha256=s.sha256) for s in log.sources),
        seed=seed,
        version=__version__,
        config_sha256=config_sha256,
        baseline={key: gain.before for key, gain in totals.items()},
        findings=tuple(found),
        total_gain=totals if found and any(map(predicts, judged.values())) else {},
        ceiling=ceiling,
        joint=joint(list(estimates.values())),
        noise=noise_of_all(judged),
        smallest_detectable=tuple(sizes),
        not_judged=(
            *unseen,
            *(NotJudged(cause=c, reason=r) for c, r in reasons.items()),
        ),
        notices=notices,
        decisions=tuple(decisions_of(judged)),
    )
    shown = _shown(judged, {stage: whole.after[0] for stage, whole in wholes.items()}, before)
    terms = extension(found, fitted) if refusal is None else ()
    return Diagnosis(findings, evidence(log, shown, terms, timings))


def _findings(j: Judged, found: list[Finding]) -> dict[int, Fitted]:
    """Add the findings of one stage; return which of them is which fitted cause."""
    problem, fitted = j.prepared.problem, {}
    if j.point.model.fitted:
        causes = named(
            problem, j.point, j.ties, j.selected.p, j.drift, scrubs=j.scrubs, anchor=j.in_doubt
        )
        for f, finding in zip(j.point.model.fitted, causes, strict=True):
            fitted[len(found)] = f
            found.append(finding)
    found += beside(j)
    return fitted


def _explained(
    judged: Mapping[str, Judged], seed: int, jobs: int
) -> tuple[dict[str, Array], dict[str, Explained], dict[str, Explained]]:
    """Return the predictions of every stage without a cause, and what its causes explain.

    Last what those with a name explain by themselves: a patch has no others.
    """
    halves = judged_by_halves(judged, seed, jobs)
    before, wholes, patched = {}, {}, {}
    for stage, j in judged.items():
        base = before[stage] = j.prepared.problem.point(Model(), j.point.poses).predicted
        mine = halves.get(stage, ())
        wholes[stage] = patched[stage] = honest(j, mine, base)
        if any(half is not None and half.whole is not half.point for half in mine):
            patched[stage] = honest(j, mine, base, named=True)
    return before, wholes, patched


def _ceilings(
    judged: Mapping[str, Judged],
    before: Mapping[str, Array],
    horizon_s: float,
    rng: np.random.Generator,
) -> dict[str, float]:
    found: dict[str, float] = {}
    for stage, j in judged.items():
        p = j.prepared
        p.library.rewhiten(j.point)
        found |= ceilings(p.problem, p.library, j.point, before[stage], horizon_s, rng)
    return {key: float(f"{ratio:.{CEILING_DIGITS}g}") for key, ratio in found.items()}


def _shown(
    judged: Mapping[str, Judged], after: Mapping[str, Array], before: Mapping[str, Array]
) -> dict[str, Shown]:
    return {
        stage: Shown(
            j.prepared,
            j.point,
            before[stage],
            after[stage],
            j.scores,
            unknown=j.unknown,
            drift=j.drift,
            selection=tuple(j.selected.rows),
        )
        for stage, j in judged.items()
    }

"""A whole diagnosis: of one set of logs, of groups of them, or of two sets that are compared.

Each set is a member and is treated in the same way: its faults, its stages, the decisions on them.
The three kinds differ in what their members share.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from hilserver import __version__
from hilserver.compiled import kernel_hash
from hilserver.daemon.assembly import Assembly
from hilserver.diagnosis.catalogue.vocabulary import OF_THE_LOG
from hilserver.diagnosis.checks.standstill import (
    at_rest,
    stood_still,
    too_little_motion,
)
from hilserver.diagnosis.compare.comparison import compared
from hilserver.diagnosis.decide import one_topic
from hilserver.diagnosis.decide.beginning import Terms
from hilserver.diagnosis.examine import Member, examine
from hilserver.diagnosis.findings.ceiling import ceilings
from hilserver.diagnosis.findings.estimate import joint
from hilserver.diagnosis.findings.explain import explain_finding, of_two_wheels
from hilserver.diagnosis.findings.nested import answers_of
from hilserver.diagnosis.findings.other_logs import OtherLogs, a_rung_lower
from hilserver.diagnosis.findings.outcome import extension, other_findings, worsened
from hilserver.diagnosis.findings.worth import StageAnswer
from hilserver.diagnosis.groups.shared import (
    answers_in_groups,
    gains_in_groups,
    smallest_in_groups,
)
from hilserver.diagnosis.marks.judging import ByMarks, judge_marks
from hilserver.diagnosis.memory import one_blas_thread
from hilserver.diagnosis.progress import Report, Tracker
from hilserver.diagnosis.regression.gain import HORIZON_S
from hilserver.diagnosis.replay.judgeable import UNSEEN, absent, vocabulary_reasons
from hilserver.diagnosis.replay.model import Fitted
from hilserver.diagnosis.report.collecting import evidence
from hilserver.diagnosis.report.merging import merged
from hilserver.diagnosis.schema.evidence import Diagnosis, Evidence, FittedTerm
from hilserver.diagnosis.schema.findings import (
    ON_OTHER_LOGS,
    Detectable,
    Finding,
    Findings,
    Gain,
    GroupOfLogs,
    LogFile,
    NotJudged,
    Overall,
    overall,
)
from hilserver.measured.data import MeasuredLog
from hilserver.measured.machine import machine
from hilserver.plant.parameters import RobotParameters

T = TypeVar("T")

UNCONFIRMED = "has no name: on the other logs no error is clearly smaller for it"
HALVES = "repeating the selection on each half of the log"


def diagnose(
    log: MeasuredLog,
    assembly: Assembly,
    *,
    seed: int = 0,
    jobs: int = 2,
    progress: Report | None = None,
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
    progress: Report | None = None,
    test: MeasuredLog | None = None,
    running: Terms = MappingProxyType({}),
) -> Diagnosis:
    """Judge measured data of one machine.

    Parameters
    ----------
    robot : RobotParameters
        The configured plant, the base of all figures.
    seed : int
        For sign flips and bootstrap; equal seeds give equal findings.
    jobs : int
        Threads; the findings do not depend on it.
    progress : callable, optional
        Called with the current activity and its share.
    test : MeasuredLog, optional
        Other logs of the machine, only used to measure the total gain.
    running : mapping of str to float
        Terms that already run, in addition to the configured plant: the search starts from them and
        estimates their total values.
    """
    tracker, rng = Tracker(progress), np.random.default_rng(seed)
    member = examine(log, robot, rng, jobs, tracker, running=running)
    tracker(HALVES, 0.0)
    answers = answers_of(member.judged, seed, jobs)
    tracker.timed("halves")
    tracker("measuring the gain", 0.0)
    own = [answer.explained.gains(HORIZON_S, rng) for answer in answers]
    total = _all_of(
        answer.patch_gains(HORIZON_S, rng, gain)
        for answer, gain in zip(answers, own, strict=True)
    )
    possible = _all_of(answer.possible(HORIZON_S, rng) for answer in answers)
    marks = _by_marks(member, rng, tracker)
    total |= marks.gain
    notices, patches = (*member.log.notices, *marks.notices), [total]
    if test is not None:
        others, possible = _other_logs(member, answers, test), {}
        total = others.gains(rng, of_patch=True)
        patches.append(total)
        lost = others.unconfirmed(rng)
        answers = [a_rung_lower(answer, lost) for answer in answers]
        files = ", ".join(s.file for s in test.sources)
        doubts = (f"{cause} {UNCONFIRMED}" for cause in sorted(lost))
        notices = (*notices, *test.notices, f"{ON_OTHER_LOGS}{files}", *doubts)
    # the gain of all that predicts is that of a single cause if nothing else predicts
    alone = [j.whole is j.point for j in member.judged.values()]
    gains = [gain if one else None for gain, one in zip(own, alone, strict=True)]
    found, fitted = _collected([member], answers, rng, gains)
    fitted |= enumerate(marks.fitted, len(found))
    found += marks.findings
    ceiling = _all_of(ceilings(a.explained.parts[0], HORIZON_S, rng) for a in answers)
    sizes, unseen = member.smallest(rng)
    if stood_still(member.log):
        sizes, unseen = at_rest(sizes, unseen)
    sizes += marks.smallest
    tracker.timed("gain")
    judged = {d.cause for d in sizes} | {c for f in found for c in f.causes}
    reasons = {u.cause: u.reason for u in unseen} | member.reasons | marks.reasons
    reasons = vocabulary_reasons(
        judged, reasons, set(member.judged), absent(member.log), UNSEEN
    )
    judgement = _diagnosis(
        [member],
        answers,
        found,
        fitted,
        worsened(*patches),
        tracker,
        total_gain=total,
        possible_gain=possible,
        seed=seed,
        config_sha256=config_sha256,
        ceiling=ceiling,
        noise=member.noise,
        smallest_detectable=tuple(sizes),
        not_judged=_not_judged(reasons),
        notices=notices,
    )
    fitted_in = judgement.evidence.fitted.model_copy(update=dict(marks.ranges))
    seen = replace(judgement.evidence, fitted=fitted_in, marked_ends=marks.ends)
    return replace(judgement, evidence=seen)


def _by_marks(member: Member, rng: np.random.Generator, tracker: Tracker) -> ByMarks:
    drive = member.judged.get("drive")
    terms = {} if drive is None else drive.lasting.terms
    marks = judge_marks(member.log, member.robot, terms, rng, tracker)
    tracker.timed("marks")
    return marks


@one_blas_thread
def diagnose_groups(
    logs: Mapping[str, MeasuredLog],
    assembly: Assembly,
    *,
    seed: int = 0,
    jobs: int = 2,
    progress: Report | None = None,
) -> Diagnosis:
    """Judge groups of logs of one machine, on several floors or with several loads.

    Parameters
    ----------
    logs : mapping of str to MeasuredLog
        By name of the group.
    """
    tracker = Tracker(progress)
    members = []
    for name, log in logs.items():
        own, of_group = np.random.default_rng(seed), tracker.of_group(name)
        members.append(examine(log, assembly.robot, own, jobs, of_group, name))
    tracker("fitting all groups together", 0.0)
    answers = answers_in_groups(members, seed)
    tracker.timed("joint fit")
    tracker("measuring the gain", 0.0)
    rng = np.random.default_rng(seed)
    total, by_group = gains_in_groups(answers, HORIZON_S, rng)
    found, fitted = _collected(members, answers, rng)
    sizes, unseen = smallest_in_groups(members, seed)
    tracker.timed("gain")
    return _diagnosis(
        members,
        answers,
        found,
        fitted,
        worsened(total, *by_group.values()),
        tracker,
        total_gain=total,
        possible_gain={},
        seed=seed,
        config_sha256=assembly.config.sha256,
        smallest_detectable=tuple(sizes),
        not_judged=tuple(unseen),
        notices=tuple(note for m in members for note in m.log.notices),
        groups={
            m.name: _group(m, by_group.get(m.name, {}) if fitted else {})
            for m in members
        },
    )


@one_blas_thread
def compare(
    log: MeasuredLog,
    other: MeasuredLog,
    assembly: Assembly,
    *,
    seed: int = 0,
    jobs: int = 2,
    progress: Report | None = None,
) -> Diagnosis:
    """Judge whether `other` differs from `log`, and how.

    Returns
    -------
    Diagnosis
        Verdict ``differs`` or ``no_difference``; parameters ``<cause>.a`` and ``<cause>.b`` are the
        values of both sets, ``<cause>`` their difference.
    """
    robot = machine(log, assembly.robot)
    both = [one_topic.checked(one, robot) for one in (log, other)]
    result = compared(both, robot, seed, jobs, Tracker(progress))
    still = (
        [too_little_motion()]
        if any(stood_still(checked.log) for checked in both)
        else []
    )
    faults = _of_both(*(checked.findings for checked in both))
    silent = Overall.NO_DIFFERENCE if result.sizes else Overall.NOT_JUDGED
    verdict = Overall.DIFFERS if result.findings else silent
    findings = _findings(
        result.logs,
        verdict=verdict,
        seed=seed,
        config_sha256=assembly.config.sha256,
        findings=(*faults, *result.findings, *still),
        smallest_detectable=result.sizes,
        not_judged=_not_judged(result.reasons),
        notices=tuple(note for one in result.logs for note in one.notices),
    )
    return Diagnosis(findings, Evidence())


def _of_both(first: Sequence[Finding], second: Sequence[Finding]) -> list[Finding]:
    """Return the faults of two sets of logs, one that both have once."""
    own = {(f.causes, f.regressors): f for f in first}
    other = {(f.causes, f.regressors): f for f in second}
    found = []
    for fault, finding in (other | own).items():
        alone = "the first set" if fault in own else "the second set"
        where = "both sets" if fault in own and fault in other else alone
        text = f"In {where}: {explain_finding(finding)}"
        found.append(finding.model_copy(update={"explanation": text}))
    return found


def _other_logs(
    member: Member, answers: Sequence[StageAnswer], test: MeasuredLog
) -> OtherLogs:
    """Return other logs by which the patch is judged."""
    log = one_topic.checked(test, member.robot).log
    patch = {stage: a.model for stage, a in zip(member.judged, answers, strict=True)}
    return OtherLogs.of(log, member.robot, patch, HORIZON_S)


def _collected(
    members: Sequence[Member],
    answers: Sequence[StageAnswer],
    rng: np.random.Generator,
    gains: Iterable[dict[str, Gain] | None] | None = None,
) -> tuple[list[Finding], dict[int, Fitted]]:
    """Return all findings, and the fitted cause that belongs to each.

    Parameters
    ----------
    gains : iterable of dict of str to Gain or None, optional
        Gains of all causes of each stage, if known.
    """
    found = [_in(m.name, fault) for m in members for fault in m.faults]
    fitted: dict[int, Fitted] = {}
    for answer, gain in zip(answers, gains or [None] * len(answers), strict=True):
        fitted |= enumerate(answer.model.fitted, len(found))
        found += answer.with_worth(HORIZON_S, rng, gain)
        for part in answer.explained.parts:
            found += [_in(part.member, one) for one in other_findings(part.judged)]
    found += [_in(m.name, too_little_motion()) for m in members if stood_still(m.log)]
    if members[0].robot.wheelbase_m is None:
        found = [of_two_wheels(finding) for finding in found]
    return found, fitted


def _all_of(by_stage: Iterable[dict[str, T]]) -> dict[str, T]:
    return {key: value for one in by_stage for key, value in one.items()}


def _group(m: Member, gain: dict[str, Gain]) -> GroupOfLogs:
    files = tuple(s.file for s in m.log.sources)
    return GroupOfLogs(logs=files, noise=m.noise, total_gain=gain)


def _in(group: str, finding: Finding) -> Finding:
    """Return the finding of a single group, in words."""
    if not group:
        return finding
    text = f"In group {group}: {explain_finding(finding)}"
    return finding.model_copy(update={"explanation": text})


def _not_judged(reasons: Mapping[str, str]) -> tuple[NotJudged, ...]:
    return tuple(
        NotJudged(cause=cause, reason=reason) for cause, reason in reasons.items()
    )


def _diagnosis(
    members: Sequence[Member],
    answers: Sequence[StageAnswer],
    found: Sequence[Finding],
    fitted: Mapping[int, Fitted],
    refusal: str | None,
    tracker: Tracker,
    *,
    total_gain: Mapping[str, Gain],
    possible_gain: Mapping[str, Gain],
    notices: tuple[str, ...],
    smallest_detectable: tuple[Detectable, ...],
    **fields: Any,
) -> Diagnosis:
    """Return findings and evidence.

    Parameters
    ----------
    refusal : str or None
        Why there is no extension.
    fields
        Of `Findings`.
    """
    terms = extension(found, fitted) if refusal is None else ()
    holds = bool(terms) and any(
        OF_THE_LOG.keys().isdisjoint(f.terms) for f in fitted.values()
    )
    findings = _findings(
        [m.log for m in members],
        verdict=overall(found, is_judged=bool(smallest_detectable)),
        baseline={key: gain.before for key, gain in total_gain.items()},
        findings=tuple(found),
        total_gain=dict(total_gain) if holds else {},
        patch_gain=dict(total_gain) if holds else {},
        possible_gain=dict(possible_gain) if holds else {},
        smallest_detectable=smallest_detectable,
        joint=joint([answer.estimate for answer in answers]),
        notices=notices if refusal is None else (*notices, refusal),
        decisions=tuple(row for m in members for row in m.decisions),
        **fields,
    )
    parts = {m.name: _evidence(m, answers, terms, tracker) for m in members}
    return Diagnosis(findings, merged(parts), members[0].robot)


def _findings(
    logs: Iterable[MeasuredLog], *, notices: Iterable[str], **fields: Any
) -> Findings:
    files = tuple(
        LogFile(file=s.file, sha256=s.sha256) for log in logs for s in log.sources
    )
    once = tuple(dict.fromkeys(notices))
    return Findings(
        logs=files, version=__version__, kernels=kernel_hash(), notices=once, **fields
    )


def _evidence(
    m: Member,
    answers: Sequence[StageAnswer],
    terms: tuple[FittedTerm, ...],
    tracker: Tracker,
) -> Evidence:
    own = [part for a in answers for part in a.explained.parts if part.member == m.name]
    return evidence(m.log, own, terms, tracker.timings_s)

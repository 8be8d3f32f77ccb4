"""A diagnosis of several groups of logs: what belongs to the machine, what to its floor or load.

Every group is examined by itself: its data faults, its noise, the causes its logs show. The causes
of all groups are one model, which is fitted to all of them; each of its parameters is shared by the
groups, or free where they differ.
"""

import time
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from hilserver import __version__
from hilserver.daemon.assembly import Assembly
from hilserver.diagnosis.catalogue.candidate import STAGES
from hilserver.diagnosis.checks.standstill import stood_still, too_little_motion
from hilserver.diagnosis.compare.comparison import run_of_spans
from hilserver.diagnosis.engine import HORIZON_S, silent
from hilserver.diagnosis.examine import (
    Examined,
    Tell,
    beside,
    decisions_of,
    examine,
    noise_of_all,
    smallest_of,
)
from hilserver.diagnosis.findings.estimate import Estimate, joint
from hilserver.diagnosis.findings.explain import explain_finding
from hilserver.diagnosis.findings.outcome import extension, worsened
from hilserver.diagnosis.findings.worth import Explained, Predictions, with_worth, without_causes
from hilserver.diagnosis.groups.deciding import Decided, decided, with_what_remains
from hilserver.diagnosis.groups.finding import estimate_in_groups, fitted_findings
from hilserver.diagnosis.groups.joint_fit import Member, refitted
from hilserver.diagnosis.memory import one_blas_thread
from hilserver.diagnosis.regression.gain import Pair, errors, pooled_gains
from hilserver.diagnosis.replay.judgeable import vocabulary_reasons
from hilserver.diagnosis.replay.model import Fitted, Model
from hilserver.diagnosis.report.merging import merged
from hilserver.diagnosis.report.showing import Shown, evidence
from hilserver.diagnosis.schema.evidence import Diagnosis
from hilserver.diagnosis.schema.findings import (
    Detectable,
    Finding,
    Findings,
    Gain,
    GroupOfLogs,
    LogFile,
    NotJudged,
    overall,
)
from hilserver.measured.data import MeasuredLog

Array = NDArray[np.float64]


@one_blas_thread
def diagnose_groups(
    logs: Mapping[str, MeasuredLog],
    assembly: Assembly,
    *,
    seed: int = 0,
    jobs: int = 2,
    horizon_s: float = HORIZON_S,
    progress: Tell | None = None,
) -> Diagnosis:
    """Judge groups of logs of one machine.

    Parameters
    ----------
    logs : mapping of str to MeasuredLog
        By name of the group.
    """
    started = time.perf_counter()
    timings: dict[str, float] = {}

    def lap(name: str) -> None:
        spent_s = time.perf_counter() - started - sum(timings.values())
        timings[name] = timings.get(name, 0.0) + spent_s

    tell = progress or silent
    examined = {
        name: examine(log, assembly.robot, np.random.default_rng(seed), jobs, _of(tell, name), lap)
        for name, log in logs.items()
    }
    tell("fitting all groups together", 0.0)
    stages = [
        with_what_remains(decided(members), np.random.default_rng(seed))
        for stage in STAGES
        if (members := _members(examined, stage))
    ]
    lap("joint fit")
    tell("measuring the gain", 0.0)
    wholes = [explained_in_groups(d) for d in stages]
    rng = np.random.default_rng(seed)
    total, by_group = _gains(stages, wholes, horizon_s, rng)
    found = [_in(name, f) for name, e in examined.items() for f in e.checked.findings]
    fitted: dict[int, Fitted] = {}
    estimates: list[Estimate] = []
    for d, whole in zip(stages, wholes, strict=True):
        if d.joint is not None:
            estimates.append(estimate_in_groups(d.joint, [m.group for m in d.members]))
            for index, finding in enumerate(fitted_findings(d)):
                fitted[len(found)] = d.joint.model(0).fitted[index]
                found.append(with_worth(finding, index, whole, estimates[-1], horizon_s, rng))
        for m in d.members:
            found += [_in(m.group, f) for f in beside(m.judged)]
    found += [_in(name, too_little_motion()) for name, e in examined.items() if stood_still(e.log)]
    sizes, unseen = _smallest(examined, seed)
    lap("gain")
    refusal = worsened(total, *by_group.values())
    findings = Findings(
        verdict=overall(found),
        logs=tuple(LogFile(file=s.file, sha256=s.sha256) for g in logs.values() for s in g.sources),
        seed=seed,
        version=__version__,
        config_sha256=assembly.config.sha256,
        baseline={key: gain.before for key, gain in total.items()},
        findings=tuple(found),
        total_gain=total if fitted else {},
        joint=joint(estimates),
        smallest_detectable=tuple(sizes),
        not_judged=tuple(unseen),
        notices=(
            *dict.fromkeys(note for log in logs.values() for note in log.notices),
            *((refusal,) if refusal is not None else ()),
        ),
        decisions=tuple(d for name, e in examined.items() for d in decisions_of(e.judged, name)),
        groups={
            name: GroupOfLogs(
                logs=tuple(s.file for s in logs[name].sources),
                noise=noise_of_all(e.judged),
                total_gain=by_group.get(name, {}) if fitted else {},
            )
            for name, e in examined.items()
        },
    )
    terms = extension(found, fitted) if refusal is None else ()
    shown = {name: _shown(stages, wholes, name) for name in examined}
    parts = {name: evidence(e.log, shown[name], terms, timings) for name, e in examined.items()}
    return Diagnosis(findings, merged(parts))


def explained_in_groups(d: Decided) -> Explained:
    """Return what the causes of one stage explain in all groups."""
    before = tuple(m.problem.point(Model(), m.judged.point.poses).predicted for m in d.members)
    fitted = d.joint
    after = before if fitted is None else fitted.held_out()

    def without(causes: frozenset[int]) -> Predictions:
        assert fitted is not None
        if len(causes) == len(fitted.points[0].model.fitted):
            return before
        models = [without_causes(point.model, causes) for point in fitted.points]
        slices = fitted.points[0].model.slices
        gone = [i for cause in causes for i in range(slices[cause].start, slices[cause].stop)]
        return refitted(d.members, models, np.delete(fitted.all.free, gone)).held_out()

    return Explained(tuple(m.problem for m in d.members), before, after, without)


def _members(examined: Mapping[str, Examined], stage: str) -> list[Member]:
    """Return one stage of every group that has it."""
    members = []
    for name, e in examined.items():
        if stage in e.judged:
            problem = e.judged[stage].prepared.problem
            stack, runs = problem.stack, run_of_spans([e.log])
            run_of_block = np.full(stack.n_blocks, -1, dtype=np.int64)
            run_of_block[stack.block] = runs[problem.stage.segments.span[stack.segment]]
            members.append(Member(name, e.judged[stage], run_of_block))
    return members


def _gains(
    stages: list[Decided], wholes: list[Explained], horizon_s: float, rng: np.random.Generator
) -> tuple[dict[str, Gain], dict[str, dict[str, Gain]]]:
    """Return the gain over all groups, and that of each group."""
    total: dict[str, Gain] = {}
    by_group: dict[str, dict[str, Gain]] = {}
    for d, whole in zip(stages, wholes, strict=True):
        parts: list[dict[str, Pair]] = []
        for m, before, after in zip(d.members, whole.before, whole.after, strict=True):
            own = errors(m.problem, (before, after), horizon_s)
            parts.append(own)
            by_group[m.group] = by_group.get(m.group, {}) | pooled_gains([own], rng)
        total |= pooled_gains(parts, rng)
    return total, by_group


def _smallest(
    examined: Mapping[str, Examined], seed: int
) -> tuple[list[Detectable], list[NotJudged]]:
    """Return what the group that shows a cause best would have shown of it."""
    sizes: dict[str, Detectable] = {}
    unseen: dict[str, NotJudged] = {}
    for e in examined.values():
        own, silent_ones = smallest_of(e.judged, np.random.default_rng(seed))
        for size in own:
            if size.cause not in sizes or size.size < sizes[size.cause].size:
                sizes[size.cause] = size
        unseen |= {one.cause: one for one in silent_ones}
        why = vocabulary_reasons({d.cause for d in own}, e.reasons, set(e.judged))
        unseen |= {c: NotJudged(cause=c, reason=r) for c, r in why.items() if c not in unseen}
    return list(sizes.values()), [one for cause, one in unseen.items() if cause not in sizes]


def _shown(stages: list[Decided], wholes: list[Explained], group: str) -> dict[str, Shown]:
    """Return the stages of one group as the report draws them."""
    shown: dict[str, Shown] = {}
    for d, whole in zip(stages, wholes, strict=True):
        for m, before, after in zip(d.members, whole.before, whole.after, strict=True):
            if m.group == group:
                j = m.judged
                shown[m.problem.stage.name] = Shown(
                    j.prepared, j.point, before, after, j.scores, j.unknown, j.drift,
                    tuple(j.selected.rows),
                )  # fmt: skip
    return shown


def _in(group: str, finding: Finding) -> Finding:
    """Return the finding of one group alone, in words."""
    text = f"In group {group}: {explain_finding(finding)}"
    return finding.model_copy(update={"explanation": text})


def _of(tell: Tell, group: str) -> Tell:
    """Return what tells of one group."""
    return lambda text, share: tell(f"{group}: {text}", share)

"""Whether findings are what the logs of a scenario must lead to."""

from dataclasses import dataclass
from typing import Final

from hilserver.diagnosis.schema.findings import Finding, Findings, Verdict
from hilserver.scenarios.expectation import Expectation

_CONFIDENT: Final = frozenset(
    {
        Verdict.NAMED,
        Verdict.NAMED_GROUP,
        Verdict.DRIFT,
        Verdict.DATA_FAULT,
        Verdict.DIFFERS,
    }
)


@dataclass(frozen=True, slots=True)
class Judgement:
    """Whether findings are what a drive must lead to."""

    right: bool
    wrong: tuple[str, ...]  # confident findings that hold nothing of the truth
    missing: tuple[str, ...]  # in words, what was not said or should not have been said


def causes_of(finding: Finding) -> frozenset[str]:
    """Return the causes of a finding without their parts."""
    return frozenset(cause.partition(".")[0] for cause in finding.causes)


def judge(expected: Expectation, findings: Findings) -> Judgement:
    """Compare findings with an expectation."""
    confident = [f for f in findings.findings if f.verdict in _CONFIDENT]
    truth = frozenset().union(*expected.must_say) if expected.must_say else frozenset()
    truth |= expected.together
    wrong = tuple(
        " = ".join(sorted(causes_of(finding)))
        for finding in confident
        if not causes_of(finding) & truth
    )
    missing = [
        f"no finding of {' or '.join(sorted(names))}"
        for names in expected.must_say
        if not any(causes_of(finding) & names for finding in confident)
    ]
    if expected.or_structure and missing:
        verdicts = {finding.verdict for finding in findings.findings}
        missing = [] if Verdict.STRUCTURE_NOT_IN_LIBRARY in verdicts else missing
    if expected.together and not any(
        expected.together <= causes_of(f) for f in confident
    ):
        missing.append(f"no group of {', '.join(sorted(expected.together))}")
    said = (
        frozenset().union(*(causes_of(f) for f in confident))
        if confident
        else frozenset()
    )
    missing += [f"said {name}" for name in sorted(said & expected.must_not_say)]
    if expected.verdict is not None and findings.verdict != expected.verdict:
        missing.append(f"verdict {findings.verdict} and not {expected.verdict}")
    return Judgement(not missing and not wrong, wrong, tuple(missing))

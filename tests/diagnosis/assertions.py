"""What a diagnosis must satisfy, by name; `test_mutations` shows that each can fail."""

import numpy as np
import pytest

from hilserver.diagnosis.regression.gain import crossed, held_out
from hilserver.diagnosis.regression.screen import Blocks, critical, null_maxima, score
from hilserver.diagnosis.schema.findings import Overall, Verdict

LARGEST_GROUP = 5
WITHIN = 0.2


def said(findings):
    """The findings in one line, for messages."""
    return [f"{f.verdict}: {'|'.join(f.causes)}" for f in findings.findings]


def nothing_is_found(findings):
    assert findings.findings == (), said(findings)
    assert findings.verdict == Overall.NOTHING_FOUND
    assert findings.total_gain == {}
    assert findings.model_patch is None


def the_cause_is_named(findings, cause):
    """One finding, and it is this cause alone."""
    assert said(findings) == [f"{Verdict.NAMED}: {cause}"]


def the_twins_are_one_group(findings, *twins):
    """One finding that holds all twins and not the whole library."""
    assert len(findings.findings) == 1, said(findings)
    (finding,) = findings.findings
    assert finding.verdict == Verdict.NAMED_GROUP, said(findings)
    assert set(twins) <= set(finding.causes), said(findings)
    assert len(finding.causes) <= LARGEST_GROUP, said(findings)
    assert finding.separating_experiment, "no word on how to tell them apart"


def the_value_is_right(findings, name, true, null=0.0):
    """The value has the true sign, and lies within 20 % or holds the truth in its interval."""
    found = {
        key: p for finding in findings.findings for key, p in finding.parameters.items()
    }
    parameter = found[name]
    away, wanted = parameter.value - null, true - null
    assert away * wanted > 0.0, f"{name} is {parameter.value}, hidden was {true}"
    low, high = parameter.ci95
    assert low <= parameter.value <= high
    close = abs(away - wanted) <= WITHIN * abs(wanted)
    assert close or low <= true <= high, f"{name}: {parameter}, hidden was {true}"


def the_gain_is_honest(findings, quantity, left):
    """What was named leaves the sensors' own error, `left`, and gains by what it took away."""
    gain = findings.total_gain[quantity]
    assert gain.after == pytest.approx(left, rel=WITHIN)
    assert gain.ratio == pytest.approx(gain.before / left, rel=WITHIN)
    low, high = gain.ci95
    assert 1.0 < low <= gain.ratio <= high


def family_wise_error_holds(draws, *, level, most):
    """Of `draws` of (columns, residual, block) without an effect at most a share `most` speak."""
    rng = np.random.default_rng(0)
    alarms = []
    for columns, left, block in draws:
        blocks = Blocks.of(block, int(block.max()) + 1)
        s = score(columns[blocks.order], left[blocks.order], blocks)
        limit = critical(null_maxima([s], rng), level)
        alarms.append(np.abs(s.t).max() > limit)
    assert np.mean(alarms) <= most, (
        f"{np.mean(alarms):.1%} of {len(alarms)} logs without an effect"
    )


def no_prediction_saw_its_block(problem, model, spoil):
    """Other values in the blocks of one fold leave the held-out predictions of that fold alone.

    `spoil` changes the samples of a fold of a problem and returns the new problem.
    """
    start = problem.point(model, problem.start_poses({}))
    before = held_out(problem, crossed(problem, start, model))
    for fold in (0, 1):
        rows = problem.stack.fold[problem.stack.block] == fold
        spoilt = spoil(problem, rows)
        start = spoilt.point(model, spoilt.start_poses({}))
        after = held_out(spoilt, crossed(spoilt, start, model))
        assert np.allclose(after[rows], before[rows], rtol=0.0, atol=1e-9), (
            "saw its own block"
        )
        assert not np.allclose(after[~rows], before[~rows], rtol=0.0, atol=1e-3), (
            "nothing was fed"
        )

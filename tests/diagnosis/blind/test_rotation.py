"""Some of the library's causes, hidden blindly: other ones, other sizes, with every commit."""

import numpy as np
import pytest
from hilserver_injector import CAUSES

from tests.diagnosis.blind.campaign import UNNAMED
from tests.diagnosis.blind.drawing import FIRST, SECOND, SHORT_S, commit, seed_of
from tests.diagnosis.blind.rounds import Round, judged

NAMED_AT_LEAST, FURTHER = 0.6, 3
BESIDE_A_FAULT = 1


def rotation(secret, how_many):
    """A round, and what it hides: drives of one generator and benches of the other."""
    rng = np.random.default_rng(seed_of(secret, "rotation"))
    makers = dict(
        zip(("drive", "bench"), rng.permutation((FIRST, SECOND)).tolist(), strict=True)
    )
    made = Round(secret, {"mecanum": FIRST} | makers, SHORT_S)
    order = rng.permutation(sorted(CAUSES.keys() - UNNAMED)).tolist()
    left = [cause for cause in order if made.can_hide(cause)]
    logs, nulls = [], []
    while left and len(logs) < how_many:
        some, left = left[: how_many - len(logs)], left[how_many - len(logs) :]
        nulls += made.measure(made.drive_of(cause) for cause in some)
        for cause in some:
            shown = made.hidden(cause, fault=len(logs) < BESIDE_A_FAULT)
            logs += [] if shown is None else [shown]
    return made, nulls, logs


@pytest.mark.parametrize("how_many", [5, pytest.param(12, marks=pytest.mark.long)])
def test_hidden_causes_have_their_names(how_many):
    secret = commit()
    made, nulls, logs = rotation(secret, how_many)
    assert not [(log.drive, said) for log, said in nulls if said.how != "silent"]
    answers = [said for said, _ in judged(logs)]
    for log, said in zip(logs, answers, strict=True):
        print(
            f"{log.name} ({log.drive.maker}, {log.drive.kind}): {said}, {dict(log.causes)}"
        )
    wrong = [log.name for log, said in zip(logs, answers, strict=True) if said.wrong]
    for cause in wrong:
        again = [made.hidden(cause, number) for number in range(1, FURTHER + 1)]
        second = [said for said, _ in judged(again) if said.wrong]
        assert not second, f"{cause} has a wrong name twice: {second}"
    named = [said for said in answers if said.is_named]
    assert len(named) >= NAMED_AT_LEAST * how_many, f"secret {secret}: {answers}"
    values = sum(said.values for said in named)
    off = values - sum(said.near for said in named)
    assert off <= max(1, 0.2 * values)

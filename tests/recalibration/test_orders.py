"""What processes exchange, and what the history keeps: read as it was written, or not at all."""

import json
from dataclasses import asdict

import pytest

from hilserver.recalibration.orders import (
    JudgeOrder,
    JudgeResult,
    Looked,
    ModelsCompared,
    Share,
    Todo,
)
from hilserver.recalibration.proposals import (
    Proposal,
    ProposalStage,
    ProposedTerm,
    Quantity,
)

TERM = ProposedTerm(0.03, "1", (0.02, 0.04))
GAIN = {"yaw_rad": Quantity(0.06, 0.01, 6.0, (4.0, 8.0))}
ORDER = JudgeOrder(
    Todo(7, {"x": 1.0}, level=0.01), "w", {"a": [1]}, "/", {}, "", Share(4, (0, 1))
)
RESULT = JudgeResult(
    ModelsCompared(0.4, 1e-6, 72),
    ModelsCompared(1e-6, 1e-6, 72, GAIN),
    Looked("named", terms={"x": TERM}),
)
PROPOSAL = Proposal(
    1, ("x",), "", {"x": TERM}, gain=GAIN, windows=(1, 2), stage=ProposalStage.REJECTED
)


def proposal_of(text):
    return Proposal.from_json(json.loads(text))


READ = [(JudgeOrder.of, ORDER), (JudgeResult.of, RESULT), (proposal_of, PROPOSAL)]


def changed(made, path, value):
    """The text of `made` with another value at a path."""
    data = json.loads(json.dumps(asdict(made)))
    *way, last = path.split(".")
    place = data
    for key in way:
        place = place[key]
    place[last] = value
    return json.dumps(data)


@pytest.mark.parametrize(("read", "made"), READ)
def test_what_was_written_is_read(read, made):
    assert read(json.dumps(asdict(made))) == made


@pytest.mark.parametrize(
    ("read", "made", "path", "value"),
    [
        *((read, made, "else", 1) for read, made in READ),
        (JudgeOrder.of, ORDER, "todo.else", 1),
        (JudgeOrder.of, ORDER, "todo.window", "7"),
        (JudgeOrder.of, ORDER, "share.else", 1),
        (JudgeOrder.of, ORDER, "share.nice", 4.0),
        (JudgeResult.of, RESULT, "confirm.else", 1),
        (JudgeResult.of, RESULT, "confirm.p", "0.1"),
        (JudgeResult.of, RESULT, "confirm.gain.yaw_rad.else", 1),
        (JudgeResult.of, RESULT, "look.else", 1),
        (JudgeResult.of, RESULT, "look.terms.x.value", "0.03"),
        (JudgeResult.of, RESULT, "error", 3),
        (proposal_of, PROPOSAL, "number", "1"),
        (proposal_of, PROPOSAL, "number", True),
        (proposal_of, PROPOSAL, "stage", "lost"),
        (proposal_of, PROPOSAL, "terms.x.else", 1),
        (proposal_of, PROPOSAL, "terms.x.ci95", [0.1]),
        (proposal_of, PROPOSAL, "gain.yaw_rad.ratio", "6"),
    ],
)
def test_another_field_or_type_is_refused(read, made, path, value):
    with pytest.raises(ValueError, match=path.rpartition(".")[2]):
        read(changed(made, path, value))


@pytest.mark.parametrize("name", ["measure", "confirm", "look", "error"])
def test_a_result_has_all_its_fields(name):
    data = asdict(RESULT)
    del data[name]
    with pytest.raises(ValueError, match=name):
        JudgeResult.of(json.dumps(data))

"""The blind campaign: a round of everything, of both generators, with seeds never used before."""

from pathlib import Path

import pytest

from tests.diagnosis.blind.campaign import run, table
from tests.diagnosis.blind.judging import NAMED

RESULTS = Path("diagnose-results/blind.jsonl")
"""Not a temporary file: a campaign that was stopped goes on."""


@pytest.mark.long
def test_a_round_of_everything():
    answers = run(RESULTS)
    text = table(answers)
    print(text)
    assert {a["how"] for a in answers if a["group"] == "null"} == {"silent"}, text
    for group, share in (("single", 0.9), ("pair", 0.75)):
        mine = [a for a in answers if a["group"] == group]
        named = [a for a in mine if a["how"] in NAMED and not a["wrong"]]
        assert len(named) >= share * len(mine), text
    assert sum(bool(a["wrong"]) for a in answers) <= 0.02 * len(answers), text

"""The rows of what rules ask of causes: they name causes that there are."""

import pytest

from hilserver.diagnosis.catalogue.library import drive_candidates, pose_candidates
from hilserver.diagnosis.catalogue.traits import (
    TRAITS,
    Need,
    Traits,
    lacking,
    traits_of,
)
from hilserver.diagnosis.catalogue.vocabulary import CAUSES, cause_of, part_of

CANDIDATES = [*drive_candidates(), *pose_candidates((-2.0, 2.0, -2.0, 2.0))]


@pytest.mark.parametrize("cause", TRAITS)
def test_a_row_is_of_a_cause_and_points_to_causes(cause):
    row = TRAITS[cause]
    assert cause in CAUSES
    assert row != Traits(), "a row that says nothing"
    for name in (row.scrubs_as, row.field):
        assert not name or part_of(name).name == name
    for name in (row.mirrored_by, *row.together, *row.everywhere):
        assert not name or cause_of(name).name == name
    if row.mirrored_by:
        assert part_of(row.mirrored_by).unit == part_of(cause).unit


def test_a_cause_without_a_row_has_no_trait():
    assert traits_of("of another library") == Traits()


def test_a_cause_is_judged_or_says_why_not():
    judged = {c.cause for c in CANDIDATES}
    assert not {cause for cause in judged if traits_of(cause).not_judged}


def test_of_several_things_that_are_missing_the_last_one_is_the_reason():
    drive = {c.cause for c in CANDIDATES if c.stage == "drive"}
    found = lacking([Need.STAMPS, Need.DUTY, Need.SPEED], drive)
    assert found["process_gain"] == Need.SPEED.value
    assert found["dead_zone"] == Need.DUTY.value
    assert found["actuation_delay"] == Need.STAMPS.value
    assert "side_slip" not in found

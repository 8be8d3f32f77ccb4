"""What two sets of logs may differ in."""

import pytest

from hilserver.diagnosis.catalogue.library import drive_candidates, pose_candidates
from hilserver.diagnosis.compare.differences import Difference

CANDIDATES = {c.label: c for c in (*drive_candidates(), *pose_candidates(None))}


@pytest.mark.parametrize(
    ("label", "values", "possible"),
    [
        ("battery_sag", (-1.75, -0.26), False),
        ("battery_sag", (0.1, 0.9), True),
        ("coulomb_friction", (-0.03, 4.4), True),
        ("coulomb_friction", (-1.6, 4.4), False),
        ("viscous_load", (0.03, -0.2), False),
        ("process_gain", (-0.05, 0.05), True),
        ("process_gain", (-0.9, 0.05), False),
        ("rotation_gain", (-0.47, 0.0), True),
        ("saturation_limit@65", (-20.0, 0.0), True),
    ],
)
def test_values_that_no_machine_can_have_explain_nothing(label, values, possible):
    """A load on the floor looks a little like a battery whose voltage made the drive faster."""
    difference = Difference(
        CANDIDATES[label], "drive", 0, values, (0.01, 0.01), 1e-9, 1e6, 30.0
    )
    assert difference.is_possible == possible

"""How a position of four ranges moves when one of them is wrong."""

from types import SimpleNamespace

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest
from scipy.optimize import least_squares

from hilserver.diagnosis.decide.anchors import anchor_off
from hilserver.diagnosis.decide.unknown import ANCHORS_OUTSIDE, anchor_fields
from hilserver.diagnosis.replay.pose_stage import PoseStage

SIDES_M = [(-4.0, 3.0), (-1.0, 2.5)]
"""Where the robot drove: x and y from and to."""


def anchors_m():
    """The four places where anchors are taken to stand, against the clock."""
    (x0, x1), (y0, y1) = [
        (low - m, high + m)
        for low, high in SIDES_M
        for m in [ANCHORS_OUTSIDE * (high - low) + 0.5]
    ]
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])


def pushed(place, wrong, error_m):
    """How far from a place the point lies that fits four ranges best, one of them wrong."""
    anchors = anchors_m()
    ranges = np.linalg.norm(place - anchors, axis=1)
    ranges[wrong] += error_m
    found = least_squares(
        lambda moved: np.linalg.norm(place + moved - anchors, axis=1) - ranges,
        np.full(2, 1e-3),
        method="lm",
        xtol=1e-12,
    )
    return found.x


@hypothesis.given(
    st.floats(*SIDES_M[0]),
    st.floats(*SIDES_M[1]),
    st.integers(0, 3),
    st.sampled_from([-1.0, 1.0]),
)
def test_the_field_is_what_least_squares_of_the_ranges_makes(x, y, wrong, side):
    error_m = 1e-4 * side
    motion = SimpleNamespace(x=np.array([x, *SIDES_M[0]]), y=np.array([y, *SIDES_M[1]]))
    moved = pushed(np.array([x, y]), wrong, error_m)
    assert anchor_fields(motion)[wrong, 0] * error_m == pytest.approx(moved, abs=1e-7)
    assert np.abs(moved).max() > 1e-5, "large beside the tolerance"


def test_a_range_too_long_pushes_away_from_its_anchor():
    motion = SimpleNamespace(
        x=np.array([0.0, *SIDES_M[0]]), y=np.array([0.0, *SIDES_M[1]])
    )
    for field, anchor in zip(anchor_fields(motion), anchors_m(), strict=True):
        assert field[0] @ (np.zeros(2) - anchor) > 0.0


def test_a_reference_whose_error_lasts_has_no_anchors():
    stage = PoseStage.__new__(PoseStage)
    stage.begins_anew = False
    stage.log = SimpleNamespace(pose_errors_last=True)
    stage.stack = SimpleNamespace(edges={"nav.x_m": slice(0, 100)})
    library = SimpleNamespace(problem=SimpleNamespace(stage=stage))
    rng = np.random.default_rng(0)
    assert anchor_off(library, SimpleNamespace(), (), rng, 0.0) is None

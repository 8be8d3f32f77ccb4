"""Rivals where far more than noise is left: only the blocks tell them apart."""

import numpy as np
import pytest

from hilserver.diagnosis.decide.identifiability import Rival
from hilserver.diagnosis.regression.problem import Point
from hilserver.diagnosis.replay.model import Model
from tests.diagnosis import toy

SAMPLES = 100
BLANK = np.zeros(SAMPLES)


def rival(left_sd: float, cosine: float, z: float) -> Rival:
    left = np.full(SAMPLES, left_sd)
    point = Point(Model(), np.zeros((1, 3)), BLANK, left, left, left**2)
    return Rival(toy.candidate("other"), point, cosine, 200.0, z)


@pytest.mark.parametrize(
    ("left_sd", "cosine", "z", "ties"),
    [
        (1.0, 0.7, 1.0, False),
        (1.0, 0.96, 1.0, True),
        (2.0, 0.7, 1.0, True),
        (2.0, 0.5, 1.0, False),
        (2.0, 0.7, 3.0, False),
    ],
)
def test_unlike_causes_are_told_apart_where_only_noise_is_left(left_sd, cosine, z, ties):
    assert rival(left_sd, cosine, z).ties is ties

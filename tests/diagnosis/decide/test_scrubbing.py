"""The ratio of friction across to friction along that turns like a rotation gain."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilserver.diagnosis.catalogue.library import pose_candidates
from hilserver.diagnosis.decide.scrubbing import (
    as_friction,
    is_on_time,
    late_turn,
    may_scrub,
)
from hilserver.diagnosis.regression.problem import Point
from hilserver.diagnosis.replay.model import Fitted, Model
from hilserver.diagnosis.schema.findings import Parameter
from hilserver.plant.friction import anisotropy
from hilserver.plant.parameters import RobotParameters

ROBOT = RobotParameters()
(GAIN,) = (c for c in pose_candidates(None) if c.cause == "rotation_gain")


def told(a, half=0.01):
    own = Parameter(value=a, ci95=(a - half, a + half), unit="1")
    return as_friction(ROBOT, Fitted(GAIN, (a,)), own)


@settings(max_examples=25)
@given(ratio=st.floats(1.2, 5.0))
def test_it_is_the_inverse_of_the_plant(ratio):
    even = ROBOT.track_m / (ROBOT.wheelbase_m**2 + ROBOT.track_m**2)
    factor, _ = anisotropy(ROBOT.wheelbase_m, ROBOT.track_m, ratio, 0.0)
    found = told(factor * even / ROBOT.k_om - 1.0, 1e-4)
    assert found.value == pytest.approx(ratio, rel=2e-3)
    low, high = found.ci95
    assert low < found.value < high


@pytest.mark.parametrize("a", [-0.999, 5.0])
def test_a_gain_that_no_friction_makes_has_no_ratio(a):
    assert told(a) is None


@pytest.mark.parametrize(
    ("cause", "late_s", "expected"),
    [("imu_latency", 0.008, 0), ("clock_offset", 0.015, 0), ("imu_latency", 0.05, None),
     ("clock_offset", -0.01, None), ("rotation_gain", 0.01, None)],
)  # fmt: skip
def test_only_a_short_latency_is_what_tyres_make(cause, late_s, expected):
    candidate = next(c for c in pose_candidates(None) if c.cause == cause)
    model = Model((Fitted(candidate, (late_s,)),))
    none = np.zeros(0)
    assert late_turn(Point(model, none, none, none, none, none)) == expected


def shown(*latencies):
    """A library of latencies, each with its score: how late [s], known to how much [s]."""
    names, late_s, sd_s = zip(*latencies, strict=True)
    every = pose_candidates(None)
    candidates = [
        next(c for c in every if c.cause == name and c.linear) for name in names
    ]
    information = np.square(1.0 / np.array(sd_s))
    scores = SimpleNamespace(
        size=np.array(late_s), deviation=np.sqrt(information), information=information
    )
    return SimpleNamespace(
        candidates=candidates,
        owner=np.arange(len(names)),
        scores=lambda point: scores,
    )


@pytest.mark.parametrize(
    ("latencies", "expected"),
    [
        ([("imu_latency", 0.0, 1e-4)], True),
        ([("imu_latency", 0.001, 1e-4)], False),
        ([("imu_latency", 0.0, 1e-3)], False),
        ([("yaw_latency", 0.003, 1e-3), ("imu_latency", 0.0, 1e-4)], True),
        ([("yaw_latency", -0.003, 1e-3), ("imu_latency", 0.001, 1e-4)], False),
        ([("nav_latency", 0.0, 1e-4)], False),
    ],
)
def test_the_turn_is_on_time_only_where_the_log_shows_it(latencies, expected):
    """A latency of the position says nothing of the turn."""
    assert is_on_time(shown(*latencies), None) == expected


@pytest.mark.parametrize(
    ("gain", "late_s", "expected"),
    [(-0.3, 0.0, False), (-0.3, 0.002, True), (-0.05, 0.002, False)],
)
def test_a_gain_that_may_be_late_may_be_friction(gain, late_s, expected):
    """Of a gain that ties with a radius as of one that was fitted."""
    library = shown(("imu_latency", late_s, 1e-4))
    library.problem = SimpleNamespace(stage=SimpleNamespace(robot=ROBOT))
    none, fitted = np.zeros(0), Fitted(GAIN, (gain,))
    with_gain = Point(Model((fitted,)), none, none, none, none, none)
    assert may_scrub(library, with_gain, ()) == expected
    without = Point(Model(), none, none, none, none, none)
    assert may_scrub(library, without, (fitted,)) == expected

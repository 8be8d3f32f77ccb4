"""Replays of the pose: the one by speeds alone is that of the plant's own tick."""

from itertools import pairwise

import numpy as np
import pytest

from hilserver.diagnosis.replay.model import robot_with
from hilserver.diagnosis.replay.pose_kernels import _run_segment, run_pose
from hilserver.plant.kinematics import speeds_suffice
from hilserver.plant.layout import Outputs
from hilserver.plant.packing import initial_state, pack
from hilserver.plant.parameters import RobotParameters

FIRST = np.array([0, 700, 1500])
PATCH = {"x_min": -0.5, "x_max": 0.4, "y_min": -2.0, "y_max": 0.6}
SPEEDS_ALONE = [
    {},
    {"rotation_gain": 0.03, "longitudinal_slip": 0.1, "icr_offset": 0.06},
    {"rotation_gain_speed": 0.1, "traction_slip": 0.02, "acceleration_slip": 0.05},
    {"side_slip": 0.1, "wheel_misalignment": 0.02, "wheel_radius_difference": 0.01},
    {"surface_change.k_om": 0.2, "surface_change.v": -0.1}
    | {f"surface_change.{side}": m for side, m in PATCH.items()},
]
MORE = [
    {"body_lag": 0.05},
    {"rotation_gain_radius": 0.1},
    {"wheel_runout.amplitude": 0.01, "wheel_runout.phase": 0.4},
]


def sides():
    """Sums of both sides' speeds: ahead, back, in a curve and at rest."""
    t = np.arange(1500) * 0.01
    ahead, turn = 60.0 * np.sin(0.9 * t), 40.0 * np.sin(0.4 * t + 1.0)
    ahead[300:340] = turn[300:340] = 0.0
    return ahead + turn, turn - ahead


@pytest.mark.parametrize("terms", [*SPEEDS_ALONE, *MORE])
def test_a_replay_is_the_plants_own_tick(terms):
    robot = robot_with(RobotParameters(), terms)
    p, (left, right) = pack(robot), sides()
    p.dt = 0.002
    assert speeds_suffice(p) == (terms in SPEEDS_ALONE)
    poses, angle = np.array([[0.3, -0.2, 3.1], [-0.1, 0.5, -1.0]]), np.array([0.2, 1.0])
    none, shown, ticked = np.empty((2, 0)), np.empty((1500, 4)), np.empty((1500, 4))
    x, y = initial_state(robot), Outputs.zeros()
    run_pose(p, x, np.arange(2), FIRST, left, right, none, poses, angle, y, shown)
    for s, (first, end) in enumerate(pairwise(FIRST)):
        x = initial_state(robot)
        x.pose[:] = poses[s]
        _run_segment(p, x, first, end - 1, left, right, none, angle[s], y, ticked)
    assert np.ptp(shown[:, 2]) > 2.0
    np.testing.assert_array_equal(shown[:, 2:], ticked[:, 2:])
    np.testing.assert_allclose(shown[:, :2], ticked[:, :2], rtol=0.0, atol=1e-12)

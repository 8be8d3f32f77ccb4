"""Wheels in the air, on the floor and blocked; walls; what drives cost."""

import math

import numpy as np
import pytest

from hilserver.plant.hall import Solid, wall_solids
from tests.body.rig import MECANUM, Body

WALL = wall_solids(np.array([1.0, -2.0, 1.0, 2.0]))
NO_LOAD = 111.0 * 2.0 * math.pi / 60.0
FULL = (100.0,) * 4


def front(body):
    """How far the bumper reaches."""
    return body.place[0] + 0.21 + 0.01


def step_response(t):
    """Equation (5.23) at full duty, in rad/s."""
    t1, t2 = 0.069, 0.0023
    return NO_LOAD * (1.0 - (t1 * np.exp(-t / t1) - t2 * np.exp(-t / t2)) / (t1 - t2))


def test_a_lifted_wheel_follows_the_process():
    stand = Solid((0.0, 0.0, 0.07), (0.1, 0.1, 0.07))
    body = Body(torque=True, sensors=True, solids=[stand])
    body.b.position[2] += 0.1
    body.run(1.0, 0.0, 0.0, 0.0, 0.0)
    assert body.b.normal.tolist() == [0.0] * 4
    seen = [body.run(0.002, *FULL).b.speed.copy() for _ in range(300)]
    wanted = step_response(np.arange(1, 301) * 0.002)[:, None]
    assert np.max(np.abs(np.array(seen) - wanted)) < 0.01 * NO_LOAD


def test_on_the_floor_the_robot_has_to_be_accelerated():
    body = Body(torque=True, sensors=True).run(0.1, *FULL)
    lifted = step_response(0.1)
    assert np.all(body.b.speed < 0.95 * lifted)
    body.run(2.0, *FULL)
    assert body.b.speed == pytest.approx([NO_LOAD] * 4, rel=0.03)
    assert body.velocity[0] == pytest.approx(0.085 * NO_LOAD, rel=0.03)


def test_blocked_by_a_wall_the_robot_stops_and_its_wheels_slip():
    body = Body(torque=True, sensors=True, solids=WALL).run(0.1, *FULL)
    assert body.b.bump == 0.0
    body.run(3.9, *FULL)
    assert body.b.bump == 1.0
    assert front(body) == pytest.approx(0.975, abs=0.01)  # the wall is 50 mm thick
    assert body.velocity == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    slip = body.b.slip
    assert np.all(slip > 0.1)
    grip = 0.8 * body.b.normal * slip / np.hypot(slip, 0.03)
    assert body.b.torque == pytest.approx(grip * 0.085, rel=0.02)


def test_blocked_under_load_the_drives_stall():
    heavy = {"mass_kg": 50.0, "tyre": {"v0_m_s": 0.05}}
    body = Body(torque=True, sensors=True, solids=WALL, **heavy).run(6.0, *FULL)
    assert np.all(body.b.speed < 0.05 * NO_LOAD)
    assert body.b.torque == pytest.approx([2.0] * 4, rel=0.05)


def test_driven_by_speed_the_wheels_turn_on_whatever_blocks_them():
    body = Body(solids=WALL).run(4.0, *[7.0] * 4)
    assert body.b.speed.tolist() == [7.0] * 4
    assert body.b.slip == pytest.approx([7.0 * 0.085] * 4, rel=0.01)


@pytest.mark.parametrize("speed", [2.0, 12.0, 40.0])
def test_nothing_passes_a_wall(speed):
    body = Body(solids=WALL).run(2.0, *[speed] * 4)
    assert front(body) < 0.99


def test_a_free_roll_loses_what_rolling_and_air_take():
    body = Body(torque=True, sensors=True)
    body.engine.parameters.rate = 0.0  # an open circuit: no torque
    body.b.velocity[0] = 0.5
    body.b.speed[:] = 0.5 / 0.085
    body.run(0.2, 0.0, 0.0, 0.0, 0.0)
    before, x = body.energy_j, body.place[0]
    speed = body.velocity[0]
    body.run(1.0, 0.0, 0.0, 0.0, 0.0)
    lost, way = before - body.energy_j, body.place[0] - x
    mean = 0.5 * (speed + body.velocity[0])
    wanted = (0.01 * 5.0 * 9.81 + 0.03 * mean**2) * way
    assert lost == pytest.approx(wanted, rel=0.02)


def test_a_threshold_is_climbed_and_felt():
    threshold = Solid((0.6, 0.0, 0.005), (0.02, 1.0, 0.005), carries=True)
    body, highest = Body(solids=[threshold]), 0.0
    for _ in range(100):
        highest = max(highest, body.run(0.02, *[5.0] * 4).place[2])
    assert body.place[0] > 0.75
    assert 0.063 < highest < 0.075


def test_a_slope_is_climbed():
    rise = math.atan2(0.2, 1.0)
    centre = (1.0 + 0.025 * math.sin(rise), 0.0, 0.1 - 0.025 * math.cos(rise))
    slope = Solid(
        centre, (0.5 * math.hypot(1.0, 0.2), 1.0, 0.025), 0.0, rise, carries=True
    )
    body = Body(solids=[slope]).run(2.0, *[5.0] * 4)
    assert 0.6 < body.place[0] < 1.2
    assert body.place[2] - 0.06 == pytest.approx(0.2 * (body.place[0] - 0.5), abs=0.02)


@pytest.mark.parametrize("twist", [(0.0, 0.2, 0.0), (0.15, 0.15, 0.0), (0.0, 0.0, 0.8)])
def test_a_mecanum_body_drives_like_its_kinematics(twist):
    v, vy, om = twist
    lever = 0.5 * (0.25 + 0.36)
    left = [(v - vy - lever * om) / 0.05, (v + vy - lever * om) / 0.05]
    right = [(v + vy + lever * om) / 0.05, (v - vy + lever * om) / 0.05]
    body = Body(robot=MECANUM).run(1.0, *left, *right)
    seen = [body.run(0.002, *left, *right).velocity for _ in range(100)]
    size = max(abs(part) for part in twist)
    assert np.mean(seen, axis=0) == pytest.approx(twist, abs=0.01 * size)
    # no ripple
    assert np.ptp(seen, axis=0) == pytest.approx((0.0, 0.0, 0.0), abs=0.001 * size)

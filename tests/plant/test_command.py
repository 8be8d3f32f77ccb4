"""From inputs to set-points: modes, limits, safe ramp, pose request."""

import math

import numpy as np
import pytest

from hilserver.plant.layout import COMMAND_NORMAL, COMMAND_SAFE, COMMAND_ZERO, Outputs
from hilserver.status import BAD_NO_DATA, BAD_WAITING_FOR_INITIAL_DATA, GOOD
from tests.plant.rig import Rig


def setpoints(rig):
    return rig.x.setpoint.tolist()


def test_wheel_mode_takes_the_setpoints_as_they_are():
    assert setpoints(Rig().wheels(1, 2, -3, -4).step()) == [1, 2, -3, -4]


def test_max_rpm_scales_all_wheels_together():
    rig = Rig().wheels(180, 90, -45, 0).step()
    assert setpoints(rig) == [90, 45, -22.5, 0]
    assert rig.x.scaled == 1.0
    assert rig.wheels(1, 1, 1, 1).step().x.scaled == 0.0


def test_scaled_twist_keeps_the_radius():
    fast, slow = Rig().twist(5.0, 4.0).step(3000), Rig().twist(0.05, 0.04).step(3000)
    assert fast.velocity[0] / fast.velocity[2] == pytest.approx(
        slow.velocity[0] / slow.velocity[2], rel=1e-6
    )


@pytest.mark.parametrize(
    ("v", "om", "driven"),
    [
        (0.3, 0.5, (0.3, 0.0)),
        (0.05, 1.0, (0.0, 1.0)),
        (-0.3, -0.5, (-0.3, 0.0)),
        (0.0, 1.0, None),
    ],
)
def test_exclusive_mode_drives_the_larger_part_and_says_so(v, om, driven):
    rig = Rig(exclusive_twist=True).twist(v, om).step()
    other = Rig().twist(*(driven or (v, om))).step()
    assert setpoints(rig) == setpoints(other)
    assert rig.x.twist_reduced == (driven is not None)


def test_notes_of_a_twist_do_not_outlive_it():
    rig = Rig(exclusive_twist=True).twist(5.0, 1.0).step()
    assert (rig.x.twist_reduced, rig.x.scaled) == (1.0, 1.0)
    rig.wheels(1, 1, 1, 1).step()
    assert (rig.x.twist_reduced, rig.x.scaled) == (0.0, 0.0)


def test_disabled_drive_brakes_to_rest():
    rig = Rig().wheels(50, 50, -50, -50).step(500)
    rig.u.enable = 0.0
    rig.step()
    assert setpoints(rig) == [0, 0, 0, 0]
    assert abs(rig.step(2000).y.speed[0]) < 1e-3


def test_zero_command():
    rig = Rig().wheels(50, 50, -50, -50).step(500)
    rig.u.command = COMMAND_ZERO
    assert setpoints(rig.step()) == [0, 0, 0, 0]


def ramp(rig, ticks):
    rig.u.command = COMMAND_SAFE
    return np.array([setpoints(rig.step()) for _ in range(ticks)])


def test_safe_ramp_is_linear_and_ends_in_time():
    rig = Rig(safe_ramp_s=0.1).wheels(50, 40, -30, -20).step(200)
    rig.wheels(0, 0, 0, 0)  # whatever is written meanwhile
    rows = ramp(rig, 150)
    share = np.maximum(1.0 - np.arange(1, 151) / 100, 0.0)
    assert rows == pytest.approx(np.outer(share, [50, 40, -30, -20]), abs=1e-12)
    assert not rows[99:].any()


def test_safe_ramp_starts_from_a_twist_too_and_ignores_enable():
    rig = Rig(safe_ramp_s=0.1).twist(0.2, 0.0).step(200)
    start = np.array(setpoints(rig))
    rig.u.enable = 0.0
    assert ramp(rig, 50)[-1] == pytest.approx(start / 2)


@pytest.mark.parametrize("seconds", [0.0, 0.001])
def test_shortest_ramp_stops_at_once(seconds):
    rig = Rig(safe_ramp_s=seconds).wheels(50, 40, -30, -20).step(10)
    assert not ramp(rig, 1).any()


def test_second_ramp_starts_anew():
    rig = Rig(safe_ramp_s=0.1).wheels(50, 50, -50, -50).step(10)
    ramp(rig, 150)
    rig.u.command = COMMAND_NORMAL
    assert setpoints(rig.step()) == [50, 50, -50, -50]
    assert ramp(rig, 1)[0][0] == pytest.approx(49.5)


# --- what the wheels are asked to do --------------------------------------------------------------


def test_demand_is_the_setpoint_of_each_wheel():
    rig = Rig().wheels(1, 2, -3, -4).step()
    assert rig.y.demand.tolist() == [1, 2, -3, -4]
    assert rig.q.demand.tolist() == [GOOD] * 4


def test_demand_of_a_twist_is_what_its_wheels_follow():
    rig = Rig().twist(0.3, 0.0).step()
    asked = 0.3 / 0.085 * 60.0 / (2.0 * math.pi)
    assert rig.y.demand == pytest.approx([asked, asked, -asked, -asked])
    assert rig.step(3000).y.speed == pytest.approx(rig.y.demand, abs=1e-3)


def test_demand_keeps_limit_and_rate_and_ramps_down():
    rig = (
        Rig(terms={"setpoint_rate_limit": 1000.0}, safe_ramp_s=0.1)
        .twist(5.0, 0.0)
        .step()
    )
    assert rig.y.demand.tolist() == [1, 1, -1, -1]
    assert rig.step(1000).y.demand.tolist() == [90, 90, -90, -90]
    ramp(rig, 50)
    assert rig.y.demand == pytest.approx([45, 45, -45, -45], abs=2.0)


def test_duties_demand_no_speed():
    rig = Rig().duties(20, 20, -20, -20).step()
    assert rig.q.demand.tolist() == [BAD_NO_DATA] * 4
    assert rig.wheels(1, 2, 3, 4).step().q.demand.tolist() == [GOOD] * 4


# --- duties straight to the process ---------------------------------------------------------------


def test_commanded_duty_reaches_the_process_unchanged():
    rig = Rig().duties(20, -30, 40, 0).step(1000)
    assert rig.y.duty.tolist() == [20, -30, 40, 0]
    gain = rig.robot.process.gain
    assert rig.y.speed == pytest.approx(gain * np.array([20, -30, 40, 0]), abs=1e-4)


def test_commanded_duty_ends_at_the_limit():
    rig = Rig(terms={"saturation_limit": 60.0}).duties(100, -100, 5, 0).step()
    assert rig.y.duty.tolist() == [60, -60, 5, 0]


def test_speed_loop_takes_over_without_a_jump():
    rig = Rig().duties(50, 50, -50, -50).step(1000)
    before = rig.y.speed.copy()
    duty = rig.wheels(*before).step().y.duty
    assert duty == pytest.approx([50, 50, -50, -50], abs=0.1)


def test_safe_ramp_and_disabling_end_commanded_duties():
    rig = Rig(safe_ramp_s=0.1).duties(50, 50, -50, -50).step(1000)
    rows = ramp(rig, 150)
    assert rows[0] == pytest.approx(
        0.99 * 1.11 * np.array([50, 50, -50, -50]), rel=1e-3
    )
    assert not rows[99:].any()
    rig = Rig().duties(50, 50, -50, -50).step(1000)
    rig.u.enable = 0.0
    assert abs(rig.step(2000).y.speed).max() < 1e-3


# --- gains that come in as inputs -----------------------------------------------------------------


def test_gains_of_the_configuration_given_as_inputs_change_nothing():
    plain, given = Rig().wheels(30, 30, -30, -30), Rig().wheels(30, 30, -30, -30)
    c = given.robot.controller
    given.u.own_gains, given.u.k_p, given.u.k_i = 1.0, c.k_p, c.k_i
    for _ in range(300):
        assert given.step().y.numbers == pytest.approx(plain.step().y.numbers, abs=1e-9)


def test_smaller_gains_make_a_slower_robot_until_they_are_withdrawn():
    plain, soft = Rig().wheels(60, 60, -60, -60), Rig().wheels(60, 60, -60, -60)
    soft.u.own_gains, soft.u.k_p, soft.u.k_i = 1.0, 0.5, 10.0
    assert soft.step(50).y.speed[0] < 0.6 * plain.step(50).y.speed[0]
    soft.u.own_gains = 0.0
    assert soft.step(1000).y.speed[0] == pytest.approx(60, abs=0.01)


def test_pose_request_acts_once_at_the_start_of_the_tick():
    rig = Rig().wheels(50, 50, -50, -50).step(300)
    rig.u.pose_request = 1.0
    rig.u.pose = (1.0, 2.0, math.pi + 1.0)
    rig.step()
    assert rig.y.pose.tolist() == pytest.approx([1.0, 2.0, 1.0 - math.pi])
    rig.step(100)
    assert abs(rig.pose[0] - 1.0) > 0.01


def test_outputs_become_good():
    rig = Rig().step()
    status, end = rig.q.numbers.view(np.int64), Outputs.where("angular").stop
    others = slice(end, Outputs.where("demand").start)
    assert not np.delete(status, others).any()
    assert np.all(status[others] == BAD_WAITING_FOR_INITIAL_DATA)


def test_outputs_belong_to_the_tick_before_the_move():
    """y is the state of t_k, x that of t_(k+1)."""
    rig = Rig().wheels(50, 50, -50, -50).step(100)
    before = rig.x.copy()
    rig.step()
    assert rig.y.speed.tolist() == before.speed.tolist()
    assert rig.y.pose.tolist() == before.pose.tolist()
    assert rig.x.speed[0] != before.speed[0]

"""Sensors: IMU, battery, range finders, navigation tag; and the state as a complete snapshot."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hilserver.plant.battery import open_circuit_voltage
from hilserver.plant.layout import Outputs
from hilserver.plant.parameters import Imu, Navigation, RangeFinders
from hilserver.plant.reference.cases import cases
from hilserver.plant.tof import tof_step
from hilserver.status import BAD_OUT_OF_SERVICE, GOOD, UNCERTAIN
from tests.plant.rig import Rig

QUIET = Navigation(
    enabled=True, white_noise_m=0.0, correlated_noise_m=0.0, yaw_noise_rad=0.0
)


def test_acceleration_is_the_derivative_of_the_world_velocity():
    rig = Rig().wheels(60, 60, -20, -20)
    accel, speeds, yaws = [], [], []
    for _ in range(300):
        rig.step().sense()
        accel.append([rig.y.accel_x, rig.y.accel_y])
        speeds.append(rig.velocity[:2].copy())
        yaws.append(rig.y.pose[2])
    turn = np.exp(1j * np.array(yaws))
    world = np.array(speeds) @ [1, 1j] * turn
    derivative = (world[2:] - world[:-2]) / 0.002 / turn[1:-1]
    found = (np.array(accel) @ [1, 1j])[1:-1]
    assert np.max(np.abs(found[20:] - derivative[20:])) < 0.02 * np.max(np.abs(found))


def test_centripetal_acceleration_in_a_steady_circle():
    rig = Rig(icr_offset_m=0.0).rolling(60.0, -30.0).step().sense()
    v, _, om = rig.velocity
    assert [rig.y.accel_x, rig.y.accel_y] == pytest.approx([0.0, v * om], abs=1e-12)


def test_gyro_terms():
    rig = (
        Rig(terms={"gyro_bias": 0.01, "gyro_scale": -0.47})
        .twist(0, 0.6)
        .step(2000)
        .sense()
    )
    assert rig.y.gyro == pytest.approx(0.53 * 0.6 + 0.01, abs=1e-8)


@pytest.mark.parametrize("late_s", [0.05, 0.033])
def test_imu_latency(late_s):
    plain, late = Rig(), Rig(terms={"imu_latency": late_s})
    history = []
    for _ in range(100):
        for rig in (plain, late):
            rig.wheels(30, 30, 10, 10).step(10).sense()
        history.append(plain.y.heading)
    age = late_s / 0.01
    wanted = np.interp(99 - age, np.arange(100), history)
    assert late.y.heading == pytest.approx(wanted, abs=1e-12)


def test_imu_noise_has_its_deviation():
    rig = Rig(imu=Imu(gyro_noise_rad_s=0.006), seed=7).step()
    samples = rig.sensed(5000)[:, Outputs.where("gyro")].ravel()
    assert samples.std() == pytest.approx(0.006, rel=0.05)
    assert abs(samples.mean()) < 0.0005
    assert abs(np.corrcoef(samples[1:], samples[:-1])[0, 1]) < 0.05


# --- battery --------------------------------------------------------------------------------------


def test_battery_stays_in_its_range_and_falls():
    rig = Rig().wheels(90, 90, 90, 90).step(500)
    volts = rig.sensed(20_000)[:, Outputs.where("battery")].ravel()
    assert 17.5 <= volts.min() <= volts.max() <= 23.5
    assert np.all(np.diff(volts[1:]) <= 0)
    assert volts[0] - volts[-1] > 0.01


def test_load_lowers_the_voltage():
    idle, full = (
        Rig().step().sense(),
        Rig(max_rpm=200).wheels(200, 200, -200, -200).step().sense(),
    )
    assert idle.y.battery - full.y.battery == pytest.approx(0.15 * 4 * 1.5)


def test_open_circuit_voltage():
    assert open_circuit_voltage(0.0) == 17.5
    assert open_circuit_voltage(1.0) == 23.5
    assert open_circuit_voltage(-1.0) == 17.5
    assert np.all(
        np.diff([open_circuit_voltage(c) for c in np.linspace(0, 1, 101)]) > 0
    )


def test_battery_does_not_act_on_the_base_drive():
    rigs = [Rig().wheels(40, 40, -40, -40) for _ in range(2)]
    rigs[1].x.battery_v = 17.5
    for rig in rigs:
        rig.step(300)
    assert rigs[0].pose.tobytes() == rigs[1].pose.tobytes()


def test_sagging_robot_follows_the_voltage():
    rig = Rig(terms={"battery_sag": 1.0}, max_rpm=300).wheels(300, 300, -300, -300)
    rig.x.battery_v = 17.5
    assert rig.step(3000).y.speed[0] == pytest.approx(111 * 17.5 / 19.2)


# --- range finders --------------------------------------------------------------------------------


def ranges(hall, x=0.0, y=0.0, yaw=0.0, **parameters):
    rig = Rig(**parameters)
    rig.x.pose = (x, y, yaw)
    rig.step()
    flat = np.array(hall, dtype=float).ravel()
    tof_step(rig.p, rig.x, rig.u, rig.y, rig.q, flat)
    return rig.y.tof, rig.q.tof


def test_walls_ahead_and_behind():
    found, status = ranges([[2, -9, 2, 9], [-3, -9, -3, 9]])
    assert found.tolist() == pytest.approx([1.8, 1.8, 2.8, 2.8])
    assert not status.any()


def test_order_is_fl_fr_rl_rr():
    left, right = (0.1, 0.3), (-0.3, -0.1)
    walls = [(2, left), (3, right), (-2.5, left), (-4, right)]
    found, _ = ranges([[x, y[0], x, y[1]] for x, y in walls])
    assert found.tolist() == pytest.approx([1.8, 2.8, 2.3, 3.8], rel=2e-3)


def test_beyond_five_metres_is_uncertain():
    found, status = ranges([[5.3, -9, 5.3, 9]])
    assert found.tolist() == [5.0, 5.0, 5.0, 5.0]
    assert status.tolist() == [UNCERTAIN] * 4


def test_nothing_below_one_centimetre():
    found, status = ranges([[0.2001, -9, 0.2001, 9]])
    assert found[0] == 0.01
    assert status[0] == GOOD


def test_cone_sees_what_stands_beside_the_axis():
    inside = 0.12 + 2.0 * math.tan(0.08)
    outside = 0.12 + 2.0 * math.tan(0.095)
    post = [[2.2, inside, 2.2, inside + 0.001]]
    assert ranges(post)[0][0] == pytest.approx(math.hypot(2.0, inside - 0.12), rel=1e-6)
    assert ranges([[2.2, outside, 2.2, outside + 0.1]])[0][0] == 5.0


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    st.floats(-3.1, 3.1),
    st.floats(-1, 1),
    st.floats(0.02, 1.0),
    st.integers(0, 2**32 - 1),
)
def test_range_is_that_of_the_nearest_point_in_the_cone(yaw, y, view, seed):
    """Against brute force: 20,000 points on every wall, those outside the cone left out."""
    hall = np.random.default_rng(seed).uniform(-4, 4, (6, 4))
    found, _ = ranges(hall, y=y, yaw=yaw, tof=RangeFinders(field_of_view_rad=view))
    cos, sin = math.cos(yaw), math.sin(yaw)
    origin = complex(0.2 * cos - 0.12 * sin, y + 0.2 * sin + 0.12 * cos)
    start, end = hall[:, 0] + 1j * hall[:, 1], hall[:, 2] + 1j * hall[:, 3]
    share = np.linspace(0.0, 1.0, 20_000)[:, None]
    points = (start + share * (end - start) - origin) * complex(cos, -sin)
    # nearer, points are farther apart than the cone is wide
    assume(np.abs(points).min() > 0.1)
    inside = np.abs(np.angle(points)) <= view / 2
    nearest = np.min(np.abs(points[inside]), initial=math.inf)
    assert found[0] == pytest.approx(min(max(nearest, 0.01), 5.0), abs=1e-3)


def test_a_hall_without_walls_and_the_default_one():
    assert ranges(np.zeros((0, 4)))[0].tolist() == [5.0] * 4
    rig = Rig().step().sense()
    assert rig.y.tof.tolist() == pytest.approx([4.8, 4.8, 2.8, 2.8])


# --- navigation -----------------------------------------------------------------------------------


def test_navigation_is_out_of_service_by_default():
    rig = Rig().step().sense()
    assert rig.q.nav.tolist() == [BAD_OUT_OF_SERVICE] * 3


def test_quiet_tag_shows_the_pose_at_its_rate():
    rig, changes, last = Rig(nav=QUIET).twist(0.3, 0.2), 0, None
    for _ in range(1000):
        rig.drive(1)
        changes += rig.y.nav[0] != last
        last = rig.y.nav[0]
    assert changes == 20
    rig = Rig(nav=QUIET).twist(0.3, 0.2).drive(551)
    assert rig.y.nav.tolist() == rig.y.pose.tolist()


def test_lever_arm_and_frame():
    terms = {"nav_lever_arm.x": 0.1, "nav_lever_arm.y": 0.2, "nav_frame_yaw": 0.3}
    rig = Rig(nav=QUIET, terms=terms)
    rig.x.pose = (1.0, 2.0, math.pi / 2)
    rig.step().sense()
    assert rig.y.nav.tolist() == pytest.approx([0.8, 2.1, math.pi / 2 + 0.3])


def test_latencies_of_position_and_yaw_apart():
    rig = Rig(nav=QUIET, terms={"nav_latency": 0.1, "yaw_latency": 0.15}).twist(
        0.3, 0.5
    )
    poses = {}
    for tick in range(1001):
        rig.drive(1)
        poses[tick] = rig.y.pose.copy()
    nav = rig.y.nav
    assert nav[:2].tolist() == poses[900][:2].tolist()
    assert nav[2] == poses[850][2]


def test_yaw_latency_across_the_wrap():
    rig = Rig(nav=QUIET, terms={"yaw_latency": 0.015}).rolling(-60.0, -60.0)
    for _ in range(6000):
        rig.drive(1)
        gap = math.remainder(rig.y.nav[2] - rig.y.pose[2], 2 * math.pi)
        assert abs(gap) < 0.5


def test_noise_is_white_plus_correlated():
    rig = Rig(nav=Navigation(enabled=True), seed=3).step()
    samples = rig.sensed(100_000)[::5, Outputs.where("nav")]
    x, yaw = samples[:, 0], samples[:, 2]
    assert x.std() == pytest.approx(math.hypot(0.08, 0.01), rel=0.06)
    assert yaw.std() == pytest.approx(0.0175, rel=0.12)
    lag = 12  # 0.6 s at 20 Hz
    assert np.corrcoef(x[lag:], x[:-lag])[0, 1] == pytest.approx(math.exp(-1), abs=0.08)
    assert abs(np.corrcoef(x, samples[:, 1])[0, 1]) < 0.1


def test_outliers_have_share_and_size():
    rig = Rig(
        nav=QUIET, terms={"nav_outliers.share": 0.03, "nav_outliers.size": 1.5}
    ).step()
    samples = rig.sensed(50_000)[::5, Outputs.where("nav")][:, :2]
    far = np.hypot(*samples.T)
    assert np.mean(far > 0.1) == pytest.approx(0.03, abs=0.006)
    assert far[far > 0.1] == pytest.approx(1.5)


# --- determinism ----------------------------------------------------------------------------------


def test_a_copy_of_the_state_is_a_complete_snapshot():
    everything = dict(cases()["everything"].items())
    options = {
        "nav": Navigation(enabled=True),
        "imu": Imu(gyro_noise_rad_s=0.01),
        "seed": 5,
    }
    first = Rig(terms=everything, **options).wheels(50, 50, -20, -20).drive(333)
    second = Rig(terms=everything, **options).wheels(50, 50, -20, -20)
    second.x.numbers[:] = first.x.numbers
    second.y.numbers[:] = (
        first.y.numbers
    )  # of the other slices: the frame, which a snapshot holds too
    second.ticks = first.ticks
    assert first.drive(500).y.tobytes() == second.drive(500).y.tobytes()
    assert first.x.tobytes() == second.x.tobytes()


def test_seeds_differ_and_repeat():
    def track(seed):
        return Rig(nav=Navigation(enabled=True), seed=seed).drive(300).y.tobytes()

    assert track(1) == track(1) != track(2)

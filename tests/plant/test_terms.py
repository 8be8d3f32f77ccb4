"""Terms: null changes no bit, a thousandth beyond null changes one, wrong ones are refused."""

import numpy as np
import pytest

from hilserver.plant.errors import PlantError
from hilserver.plant.layout import Inputs, Outputs, Status
from hilserver.plant.packing import initial_state, pack
from hilserver.plant.parameters import (
    FOR_MECANUM_ALONE,
    MECANUM_GEOMETRY,
    Controller,
    Navigation,
    RobotParameters,
)
from hilserver.plant.robot import robot_step
from hilserver.plant.terms import TERMS, complete
from tests.plant.base_kernel import base_step
from tests.plant.rig import Rig

NULLS = {name: term.null for name, term in TERMS.items()}
SAMPLES = 2_500
MECANUM = {"drive": "mecanum", **MECANUM_GEOMETRY}


def random_states(rng, x, u):
    for wheels in (x.motor, x.speed, x.integral):
        wheels[:] = rng.normal(0.0, 60.0, 4)
    x.angle[:] = rng.normal(0.0, 1e3, 4)
    x.pose[:] = *rng.normal(0.0, 10.0, 2), rng.uniform(-np.pi, np.pi)
    u.setpoint[:] = rng.uniform(-120.0, 120.0, 4)
    for numbers in (x.motor, x.speed, x.integral, x.angle, x.pose):
        zeros = rng.random(len(numbers)) < 0.1  # zeros of both signs must keep theirs
        numbers[zeros] = np.where(rng.random(zeros.sum()) < 0.5, 0.0, -0.0)
    u.setpoint[rng.random(4) < 0.2] = rng.choice([0.0, -0.0])


@pytest.mark.parametrize("terms", [{}, NULLS], ids=["no terms", "all terms at null"])
def test_null_terms_equal_the_separate_base_to_the_bit(terms):
    rng = np.random.default_rng(1)
    robot = RobotParameters(terms=terms)
    p = pack(robot)
    u, q = Inputs.zeros(), Status.zeros()
    u.enable = 1.0
    x, y, y_base = initial_state(robot), Outputs.zeros(), Outputs.zeros()
    for _ in range(SAMPLES):
        random_states(rng, x, u)
        x_base = x.copy()
        robot_step(p, x, u, y, q)
        base_step(p, x_base, u, y_base)
        assert y.tobytes() == y_base.tobytes()
        for name in (
            "motor",
            "speed",
            "integral",
            "angle",
            "pose",
            "accel_x",
            "accel_y",
        ):
            assert x[name].tobytes() == x_base[name].tobytes(), name


@pytest.mark.parametrize("drive", [{}, MECANUM], ids=["skid", "mecanum"])
def test_null_terms_pack_to_the_same_bits(drive):
    at_null, without = (
        pack(RobotParameters(terms=terms, **drive)) for terms in (NULLS, {})
    )
    assert at_null.tobytes() == without.tobytes()


def test_the_own_period_of_the_controller_needs_no_terms():
    assert pack(RobotParameters(terms={"control_period": 0.001})).drive_terms == 0.0


def lively(terms, **drive):
    """A run that speeds up, saturates, turns, reverses and creeps, with every sensor on."""
    nav, controller = Navigation(enabled=True), Controller(limit_pct=90.0)
    rig = Rig(terms=terms, nav=nav, controller=controller, **drive)
    apart = np.array([-1.0, 1.0, -1.0, 1.0]) * rig.robot.is_mecanum
    outputs = []
    for setpoints, ticks in (
        ((60, 60, -30, -30), 120),
        ((-9, -9, -9, -9), 200),
        ((0.02, 0.02, 0.02, 0.02), 300),
        ((80, 80, -80, -80), 60),
    ):
        rig.wheels(*(setpoints + apart))
        for _ in range(ticks):
            rig.drive(1)
            outputs.append(rig.y.numbers.copy())
    # long enough for one sample in a thousand
    long = 20_000 if "nav_outliers.share" in terms or not terms else 0
    return np.concatenate([outputs, rig.sensed(long)])


@pytest.fixture(scope="module")
def plain():
    return lively({})


def companions(term):
    """Shape parameters act only with the rest of their cause on."""
    if not term.shape:
        return {}
    mains = [t for t in TERMS.values() if t.cause == term.cause and not t.shape]
    sizes = {"nav_outliers.share": 0.5, "friction_anisotropy.ratio": 1.5}
    return {t.name: sizes.get(t.name, 0.3) for t in mains}


def beyond_null(term):
    if term.name == "control_period":
        return 0.002
    if term.name == "setpoint_rate_limit":
        return 0.001
    if term.name.endswith(".wheel"):
        return 1.0
    if term.name.startswith("surface_change.") and term.shape:
        edges = {"x_min": 0.001, "x_max": 0.05, "y_min": -0.001, "y_max": -0.001}
        return edges[term.name.partition(".")[2]]  # on the robot's way
    assert term.null is not None
    return term.null + 0.001


@pytest.mark.parametrize("name", list(TERMS))
def test_a_thousandth_changes_a_bit(name, plain):
    term = TERMS[name]
    others, drive = companions(term), MECANUM if name in FOR_MECANUM_ALONE else {}
    reference = lively(others, **drive) if others or drive else plain
    changed = lively({**others, name: beyond_null(term)}, **drive)
    assert changed.tobytes() != reference[: len(changed)].tobytes()
    assert np.all(np.isfinite(changed))


@pytest.mark.parametrize(
    ("terms", "words"),
    [
        ({"rotation_gian": 0.1}, "no such term"),
        ({"rotation_gain": float("nan")}, "outside"),
        ({"dead_zone": -1.0}, "outside"),
        ({"wheel_load": 1.0, "wheel_load.f": 2.0}, "given twice"),
        ({"wheel_load.wheel": 1.5}, "0 fl, 1 rl"),
        ({"encoder_scale.wheel": 0.5}, "0 fl, 1 rl"),
        ({"actuation_delay": 1.1}, "1023 runs"),
        ({"imu_latency": 11.0}, "1022 runs"),
        ({"control_period": 0.0005}, "below the plant slice"),
        ({"friction_anisotropy.offset": 0.13}, "half the wheelbase"),
    ],
)
def test_refused_terms(terms, words):
    with pytest.raises(PlantError, match=words) as caught:
        pack(RobotParameters(terms=terms))
    assert "\n" not in str(caught.value)
    assert "plant.terms." in str(caught.value)


def test_bare_cause_means_its_first_part():
    assert complete({"wheel_load": 3.0})["wheel_load.f"] == 3.0
    assert complete({"stribeck_friction": 4.0})["stribeck_friction.f_s"] == 4.0
    assert complete({"surface_change": 0.3})["surface_change.k_om"] == 0.3


def test_vocabulary_of_causes():
    """Every physical cause of the diagnosis is a term of the plant."""
    drive = """process_gain time_constant saturation_limit coulomb_friction viscous_load dead_zone
        stribeck_friction wheel_load battery_sag actuation_delay setpoint_rate_limit control_period
        controller_gains encoder_scale encoder_filter encoder_quantization backlash"""
    kinematics = """wheel_radius wheel_radius_difference rotation_gain rotation_gain_speed
        rotation_gain_radius longitudinal_slip acceleration_slip traction_slip roller_slip body_lag
        side_slip icr_offset wheel_misalignment floor_slope surface_change wheel_runout
        friction_anisotropy"""
    navigation = """nav_frame_yaw nav_lever_arm nav_latency yaw_latency nav_scale nav_position_bias
        nav_outliers heading_distortion"""
    inertial = "gyro_bias gyro_scale imu_latency"
    wanted = {
        "drive": drive.split(),
        "kinematics": kinematics.split(),
        "navigation": navigation.split(),
        "inertial": inertial.split(),
    }
    found = {block: [] for block in wanted}
    for term in TERMS.values():
        if term.cause not in found[term.block]:
            found[term.block].append(term.cause)
    assert found == wanted


@pytest.mark.parametrize(
    ("a", "b"),
    [
        ({"icr_offset": 0.03}, {"nav_lever_arm.x": -0.03}),
        ({"wheel_radius": 0.04}, {"nav_scale": 0.04, "rotation_gain": 0.04}),
        ({"wheel_radius": 0.04}, {"traction_slip": -0.04, "rotation_gain": 0.04}),
    ],
)
def test_exact_twins(a, b):
    """What the specification calls exact twins cannot be told apart from the tag's track."""
    quiet = Navigation(
        enabled=True, white_noise_m=0, correlated_noise_m=0, yaw_noise_rad=0
    )
    tracks = []
    for terms in (a, b):
        rig, track = Rig(nav=quiet, icr_offset_m=0.0, terms=terms).twist(0.2, 0.5), []
        for _ in range(2000):
            rig.drive(1)
            track.append(rig.y.nav.copy())
        tracks.append(np.array(track) - track[0])
    assert np.max(np.abs(tracks[0])) > 0.2
    assert tracks[0] == pytest.approx(tracks[1], abs=2e-6)


def test_steady_friction_is_paid_in_duty():
    plain, dragging = (
        Rig(terms=t).wheels(30, 30, -30, -30).step(4000)
        for t in ({}, {"coulomb_friction": 10.0})
    )
    assert dragging.y.speed[0] == pytest.approx(30.0, abs=1e-6)
    extra = dragging.y.duty - plain.y.duty
    assert extra.tolist() == pytest.approx([10, 10, -10, -10], abs=1e-6)


def test_friction_holds_at_rest():
    rig = (
        Rig(terms={"wheel_load.f": 30.0, "wheel_load.wheel": 2})
        .wheels(0.05, 0, -0.05, 0)
        .step(20)
    )
    assert rig.y.speed[2] == 0.0
    assert rig.y.speed[0] > 0.0


def test_the_loop_holds_what_the_encoder_shows():
    terms = {"encoder_scale.a": 0.25, "encoder_scale.wheel": 3}
    rig = Rig(terms=terms).wheels(30, 30, -30, -30).step(4000)
    assert rig.y.speed.tolist() == pytest.approx([30, 30, -30, -30])
    assert rig.x.speed.tolist() == pytest.approx([30, 30, -30, -24])


def test_the_encoder_rounds_what_it_shows():
    terms = {"encoder_scale.a": 0.1, "encoder_quantization": 0.5}
    rig = Rig(terms=terms).wheels(30, 30, -30, -30).step(100)
    assert rig.x.speed[0] * 1.1 - rig.y.speed[0] == pytest.approx(0.0, abs=0.25)
    assert rig.y.speed[0] % 0.5 == 0.0


def test_slip_of_the_traction_leaves_the_turn_as_it_is():
    firm, loose = (
        Rig(terms=t).twist(0.2, 0.5).step(2000) for t in ({}, {"traction_slip": 0.3})
    )
    assert loose.y.linear == pytest.approx(0.7 * firm.y.linear)
    assert loose.pose[2] == firm.pose[2]


def test_a_body_that_lags_answers_in_first_order():
    """Speed, lateral speed and way of a body at rest on wheels that turn evenly."""
    lag_s, ticks = 0.05, 80
    even = Rig().wheels(20, 20, -30, -30).step(6000)
    rig = Rig(terms={"body_lag": lag_s}).wheels(20, 20, -30, -30)
    for name in ("motor", "speed", "integral"):
        rig.x[name] = even.x[name]
    rig.step(ticks + 1)
    follows = -np.expm1(-ticks * 0.001 / lag_s)
    assert rig.velocity == pytest.approx(follows * even.velocity)
    turned = even.y.angular * (ticks * 0.001 - lag_s * follows)
    assert rig.y.pose[2] == pytest.approx(turned)


@pytest.mark.parametrize(
    ("tau_s", "ticks"), [(0.003, 3), (0.0025, 3), (0.0021, 3), (0.002, 2)]
)
def test_actuation_delay_takes_the_setpoint_valid_then(tau_s, ticks):
    rig = Rig(terms={"actuation_delay": tau_s}).wheels(10, 10, -10, -10)
    seen = [rig.step().x.setpoint[0] for _ in range(6)]
    assert seen == [0.0] * ticks + [10.0] * (6 - ticks)


def test_longest_delay():
    rig = Rig(terms={"actuation_delay": 1.023}).wheels(10, 10, -10, -10)
    seen = [rig.step().x.setpoint[0] for _ in range(1030)]
    assert seen[1022:1025] == [0.0, 10.0, 10.0]


def test_rate_limit():
    rig = Rig(terms={"setpoint_rate_limit": 100.0}).wheels(1, -1, 0.05, 0)
    rig.step(5)
    assert rig.x.setpoint.tolist() == pytest.approx([0.5, -0.5, 0.05, 0.0])


@pytest.mark.parametrize(("period_s", "runs"), [(0.002, 50), (0.01, 10), (0.0025, 40)])
def test_control_period_holds_the_duty(period_s, runs):
    rig = Rig(terms={"control_period": period_s}).wheels(2, 2, -2, -2)
    duties = [rig.step().y.duty[0] for _ in range(100)]
    assert 1 + np.count_nonzero(np.diff(duties)) == runs


def test_backlash_lets_the_motor_turn_alone():
    rig = Rig(terms={"backlash": 0.2}).wheels(20, 20, -20, -20)
    while rig.x.angle[0] < 0.0999:
        rig.step()
        assert rig.pose[0] == 0.0 or rig.x.angle[0] > 0.1
    rig.step(500)
    lost = 0.085 * 0.1
    assert rig.pose[0] == pytest.approx(0.085 * rig.x.angle[0] - lost, abs=1e-9)

"""The sampled wheel loop against independent solvers (equations 5.22, 5.23, section 2.4)."""

import dataclasses

import mpmath
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from hilserver.plant.parameters import Controller, Process, RobotParameters
from hilserver.plant.stability import ControlLoop
from tests.plant.rig import Rig

KP, KI, LIMIT = 13.513, 195.84, 100.0
GAIN, T1, T2 = 1.11, 0.069, 0.0023
TT = np.sqrt(1.0 / KI)


def sampled_loop(
    setpoint, ticks, *, dt=0.001, t1=T1, t2=T2, viscous=0.0, solver="expm"
):
    """Speeds and duties of one wheel: own controller code, process solved between the ticks."""
    a = np.array(
        [[-1 / t1, -GAIN * viscous / t1, GAIN / t1], [1 / t2, -1 / t2, 0], [0, 0, 0]]
    )
    over_tick = expm(a * dt)
    state, integral, speeds, duties = np.zeros(2), 0.0, [], []
    for k in range(ticks):
        e = setpoint(k * dt) - state[1]
        w = KP * e + integral
        u = float(np.clip(w, -LIMIT, LIMIT))
        speeds.append(state[1])
        duties.append(u)
        integral += dt * (KI * e + (u - w) / TT)
        if solver == "expm":
            state = (over_tick @ np.append(state, u))[:2]
        else:
            answer = solve_ivp(
                lambda _, z, u=u: a[:2, :2] @ z + a[:2, 2] * u,
                (0, dt),
                state,
                method="DOP853",
                rtol=1e-13,
                atol=1e-13,
            )
            state = answer.y[:, -1]
    return np.array(speeds), np.array(duties)


def plant_loop(setpoint, ticks, **parameters):
    rig = Rig(**parameters)
    dt, speeds, duties = rig.robot.period_s, [], []
    for k in range(ticks):
        rig.wheels(setpoint(k * dt), 0, 0, 0).step()
        speeds.append(rig.y.speed[0])
        duties.append(rig.y.duty[0])
    return np.array(speeds), np.array(duties)


def steps(t):
    return 3.0 if t < 0.2 else (-2.0 if t < 0.5 else 0.0)


def saturating(t):
    return 85.0 if t < 0.3 else (-85.0 if t < 0.7 else 20.0)


@pytest.mark.parametrize("setpoint", [steps, saturating])
@pytest.mark.parametrize("dt", [0.0005, 0.001, 0.002, 0.01])
def test_sampled_loop_equals_an_independent_solver(setpoint, dt):
    ticks = round(1.0 / dt)
    speeds, duties = plant_loop(setpoint, ticks, period_s=dt)
    expected_speeds, expected_duties = sampled_loop(setpoint, ticks, dt=dt)
    assert np.max(np.abs(speeds - expected_speeds)) < 1e-9
    assert np.max(np.abs(duties - expected_duties)) < 1e-8


def test_sampled_loop_equals_a_runge_kutta_solution():
    speeds, _ = plant_loop(saturating, 150)
    expected, _ = sampled_loop(saturating, 150, solver="runge-kutta")
    assert np.max(np.abs(speeds - expected)) < 1e-9
    assert np.max(np.abs(speeds)) > 20


@pytest.mark.parametrize(
    ("t1", "t2"), [(0.01, 0.01), (0.01, 0.01 + 1e-9), (0.0023, 0.069)]
)
def test_equal_and_swapped_time_constants(t1, t2):
    process = Process(t1_s=t1, t2_s=t2)
    speeds, _ = plant_loop(steps, 400, process=process, period_s=0.0002)
    expected, _ = sampled_loop(steps, 400, t1=t1, t2=t2, dt=0.0002)
    assert np.max(np.abs(speeds - expected)) < 1e-9


@pytest.mark.parametrize("viscous", [0.05, 3.0, 10.0])
def test_viscous_load_uses_the_joint_solution(viscous):
    """At 3 %/rpm and more the process itself oscillates."""
    speeds, _ = plant_loop(saturating, 800, terms={"viscous_load": viscous})
    expected, _ = sampled_loop(saturating, 800, viscous=viscous)
    assert np.max(np.abs(speeds - expected)) < 1e-9


def continuous_loop(setpoint_rpm, t):
    """Controller and process both continuous, with back-calculation."""

    def rates(_, z):
        x, n, integral = z
        e = setpoint_rpm - n
        w = KP * e + integral
        u = np.clip(w, -LIMIT, LIMIT)
        return [(GAIN * u - x) / T1, (x - n) / T2, KI * e + (u - w) / TT]

    answer = solve_ivp(
        rates,
        (0, t[-1]),
        [0, 0, 0],
        method="RK45",
        t_eval=t,
        rtol=1e-10,
        atol=1e-10,
        max_step=5e-5,
    )
    return answer.y[1]


@pytest.mark.parametrize("setpoint_rpm", [4.0, 80.0])
def test_first_order_convergence_to_the_continuous_loop(setpoint_rpm):
    """4 rpm never saturates, 80 rpm does for most of the run."""
    t = np.arange(1, 26) * 0.004
    exact = continuous_loop(setpoint_rpm, t)
    errors = []
    for dt in (0.0005, 0.00025, 0.000125, 0.0000625):
        every = round(0.004 / dt)
        speeds, _ = plant_loop(lambda _: setpoint_rpm, every * 25 + 1, period_s=dt)
        errors.append(np.max(np.abs(speeds[every::every] - exact)))
    ratios = np.array(errors[:-1]) / np.array(errors[1:])
    assert np.all((ratios > 1.6) & (ratios < 2.5)), errors
    assert errors[-1] < 0.02 * setpoint_rpm


def test_euler_uses_forward_differences():
    speeds, _ = plant_loop(steps, 300, discretization="euler")
    x = n = integral = 0.0
    for k in range(300):
        assert speeds[k] == pytest.approx(n, abs=1e-10)
        e = steps(k * 0.001) - n
        w = KP * e + integral
        u = min(max(w, -LIMIT), LIMIT)
        integral += 0.001 * (KI * e + (u - w) / TT)
        x, n = x + 0.001 / T1 * (GAIN * u - x), n + 0.001 / T2 * (x - n)


def test_full_duty_makes_111_rpm():
    rig = Rig(max_rpm=200.0).wheels(200, 200, -200, -200).step(2000)
    assert rig.y.speed[0] == pytest.approx(111.0)
    assert rig.y.duty.tolist() == [100, 100, -100, -100]


def test_integral_recovers_from_saturation():
    """Without back-calculation the integral would stand at thousands of percent."""
    rig = Rig(max_rpm=200.0).wheels(200, 0, 0, 0).step(3000)
    assert abs(rig.x.integral[0]) < 2000
    rig.wheels(50, 0, 0, 0).step(300)
    assert rig.y.speed[0] == pytest.approx(50, abs=0.5)


def test_derivative_part_of_the_controller():
    """tau = K_D/(N K_P), backward differences, T_t = sqrt(K_D/K_I)."""
    kd, n_filter, dt = 0.01, 10.0, 0.001
    controller = Controller(k_d=kd, derivative_n=n_filter)
    speeds, duties = plant_loop(steps, 300, controller=controller)
    tau, tt = kd / (n_filter * KP), np.sqrt(kd / KI)
    a = np.array([[-1 / T1, 0, GAIN / T1], [1 / T2, -1 / T2, 0], [0, 0, 0]])
    over, state, integral, d, last = expm(a * dt), np.zeros(2), 0.0, 0.0, 0.0
    for k in range(300):
        e = steps(k * dt) - state[1]
        d = (tau * d + kd * (e - last)) / (tau + dt)
        last = e
        w = KP * e + integral + d
        u = float(np.clip(w, -LIMIT, LIMIT))
        assert (speeds[k], duties[k]) == pytest.approx((state[1], u), abs=1e-7)
        integral += dt * (KI * e + (u - w) / tt)
        state = (over @ np.append(state, u))[:2]


def spectral_radius(loop, dt_s):
    """By eigenvalues with 50 digits, over (motor, speed, integral, derivative, last error)."""
    with mpmath.workdps(50):
        t1, t2, dt, k_p, k_d = map(
            mpmath.mpf, (loop.t1_s, loop.t2_s, dt_s, loop.k_p, loop.k_d)
        )
        rates = (
            mpmath.matrix(
                [[-1 / t1, 0, loop.gain / t1], [1 / t2, -1 / t2, 0], [0, 0, 0]]
            )
            * dt
        )
        process = mpmath.eye(3) + rates if loop.euler else mpmath.expm(rates)
        tau = k_d / (loop.derivative_n * k_p)
        keep, change = tau / (tau + dt), k_d / (tau + dt)
        motor, speed, integral, derivative, last = mpmath.eye(5).tolist()

        def total(*terms):
            return [
                mpmath.fsum(factor * row[i] for factor, row in terms) for i in range(5)
            ]

        error = total((-1, speed))
        derivative_next = total((keep, derivative), (change, error), (-change, last))
        duty = total((k_p, error), (1, integral), (1, derivative_next))
        states = (motor, speed, duty)
        rows = [
            total(*zip(process[0, :], states, strict=True)),
            total(*zip(process[1, :], states, strict=True)),
            total((1, integral), (dt * loop.k_i, error)),
            derivative_next,
            error,
        ]
        # the integral then stands still
        keeps = [0, 1, 3, 4] if loop.k_i == 0.0 else range(5)
        square = mpmath.matrix([[rows[i][j] for j in keeps] for i in keeps])
        return max(map(abs, mpmath.eig(square, left=False, right=False)))


def decades(low, high):
    return st.floats(np.log(low), np.log(high)).map(lambda x: float(np.exp(x)))


LOOPS = st.builds(
    ControlLoop,
    gain=decades(0.05, 20),
    t1_s=decades(0.0005, 100),
    t2_s=decades(0.0001, 10),
    k_p=decades(0.01, 100),
    k_i=st.one_of(st.just(0.0), decades(0.01, 2000)),
    k_d=st.one_of(st.just(0.0), decades(1e-4, 1)),
    derivative_n=st.floats(2, 50),
    euler=st.booleans(),
)


@given(loop=LOOPS, dt_s=decades(1e-5, 0.05))
def test_it_is_stable_where_all_eigenvalues_are_inside_the_circle(loop, dt_s):
    radius = spectral_radius(loop, dt_s)
    assume(abs(radius - 1) > 1e-12)
    assert loop.is_stable(dt_s) == (radius < 1)


@given(
    loop=LOOPS,
    dt_s=decades(1e-5, 0.05),
    apart=st.sampled_from([0.0, 1e-15, 1e-9, 1e-4]),
)
def test_and_so_it_is_where_both_lags_are_nearly_equal(loop, dt_s, apart):
    loop = dataclasses.replace(loop, t2_s=loop.t1_s * (1.0 + apart))
    radius = spectral_radius(loop, dt_s)
    assume(abs(radius - 1) > 1e-12)
    assert loop.is_stable(dt_s) == (radius < 1)


@pytest.mark.parametrize("dt_s", [0.0002, 0.0005, 0.001, 0.002])
def test_a_slow_process_in_short_ticks_is_stable(dt_s):
    """Its poles differ from 1 in their last digits: Jury's table in z found it unstable."""
    gains = {"k_p": 0.25, "k_i": 1.0, "k_d": 1.0, "derivative_n": 2.0}
    slow = ControlLoop(gain=2.0, t1_s=1.515625, t2_s=0.046875, euler=False, **gains)
    assert slow.is_stable(dt_s)


def test_a_derivative_without_a_proportional_part_has_no_filter_and_is_not_stable():
    loop = dataclasses.replace(RobotParameters().loop, k_p=0.0, k_d=0.01)
    assert not loop.is_stable(0.001)


def test_the_loop_becomes_unstable_at_14_6_ms():
    loop = RobotParameters().loop
    assert spectral_radius(loop, 0.0145) < 1.0 <= spectral_radius(loop, 0.0147)
    limit_s = loop.largest_period_s(0.1)
    assert limit_s == pytest.approx(0.0146, abs=5e-5)


@pytest.mark.parametrize(("dt", "grows"), [(0.0145, False), (0.0148, True)])
def test_the_limit_is_that_of_the_running_loop(dt, grows):
    """Independent of the eigenvalues: just beyond the limit the linear loop swings up."""
    speeds, _ = sampled_loop(lambda t: 1e-9 if t == 0 else 0.0, 300, dt=dt)
    early, late = np.max(np.abs(speeds[50:100])), np.max(np.abs(speeds[250:]))
    assert late < 1.0, "still linear"
    assert (late > early) == grows

"""The filter: its algebra beside filterpy's, late samples, outliers, a robot that was carried."""

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter

from hilserver.observer.correction import GATE_2
from hilserver.observer.layout import (
    BIAS,
    GAIN,
    N_ESTIMATED,
    OM,
    OU_X,
    OU_Y,
    OU_YAW,
    PLACE,
    SLIP,
    YAW,
    Moment,
    V,
)
from hilserver.observer.motion import move_on
from hilserver.observer.sensors import show_gyro, show_position, show_yaw
from tests.observer.rig import DT_S, MANY, Observed, drive, numerical, robot

N = 200


def feed(observed, d, k, *, position=None, yaw=None):
    """Give a filter everything of a moment but the tag, which may come from another one."""
    at = d.times[k]
    return observed.step(
        at,
        *d.read[k],
        gyro=(at, d.gyro[k]),
        position=None
        if position is None
        else (d.times[position], *d.position[position]),
        yaw=None if yaw is None else (d.times[yaw], d.yaw[yaw]),
    )


class Textbook(ExtendedKalmanFilter):
    """filterpy's filter with the robot's motion, everything dense and by numerical derivatives."""

    def __init__(self, observed, first):
        super().__init__(N_ESTIMATED, 1)
        self.observed, self.figures = observed, observed.figures
        self.x, self.P = first.estimate.copy()[:, None], first.covariance.copy()

    def go(self, before, now):
        def moved(x):
            before.estimate[:] = x
            out = np.zeros(N_ESTIMATED)
            move_on(self.observed.p, self.figures, before, now, out)
            return out

        x, f, dt = self.x[:, 0], self.figures, now.time - before.time
        self.F = numerical(moved, x)
        by_wheels = []
        for side in ("left", "right"):
            exact = now[side]
            now[side] = exact + 1e-6
            up = moved(x)
            now[side] = exact - 1e-6
            by_wheels.append((up - moved(x)) / 2e-6)
            now[side] = exact
        self.Q = sum(f.wheel_sd**2 * np.outer(b, b) for b in by_wheels)
        for place, sd, tau in (
            (OU_X, f.position_ou, f.position_tau),
            (OU_Y, f.position_ou, f.position_tau),
            (OU_YAW, f.yaw_ou, f.yaw_tau),
        ):
            self.Q[place, place] += sd**2 * (1.0 - np.exp(-2.0 * dt / tau))
        for place, walk in (
            (BIAS, f.bias_walk),
            (SLIP, f.slip_walk),
            (GAIN, f.gain_walk),
        ):
            self.Q[place, place] += walk * dt
        self.P = self.F @ self.P @ self.F.T + self.Q
        self.x = moved(x)[:, None]

    def take(self, shown, z, sd):
        self.R = np.atleast_2d(sd**2 * np.eye(len(z)))
        self.update(
            np.array(z)[:, None],
            lambda x: numerical(shown, x[:, 0]),
            lambda x: np.array(shown(x[:, 0]))[:, None],
            R=self.R,
        )


def test_algebra_is_that_of_filterpy():
    observed = Observed(robot(), unknown={"rotation_gain": 0.01, "wheel_radius": 0.01})
    observed.figures.wheel_drift = 0.0
    # what readings leave out between them is zero
    steady = np.full((N, 2), [5.0, -3.0])
    d = drive(observed.p, observed.figures, N, exact=steady)
    d.read[:] = steady
    first = feed(observed, d, 0, position=0, yaw=0)
    book = Textbook(observed, first)
    for k in range(1, N):
        due = k if k % 3 == 0 else None
        now = feed(observed, d, k, position=due, yaw=due)
        a, b = Moment.zeros(), Moment.zeros()
        a.time, b.time = d.times[k - 1], d.times[k]
        a.left, a.right = d.read[k - 1]
        b.left, b.right = d.read[k]
        book.go(a, b)
        book.take(
            lambda x: [show_gyro(observed.p, x, 0.0, 0.0)],
            [d.gyro[k]],
            observed.figures.gyro_sd,
        )
        if due:
            yaw = book.x[YAW, 0] + np.angle(np.exp(1j * (d.yaw[k] - book.x[YAW, 0])))
            book.take(
                lambda x: [show_yaw(observed.p, x, 0.0)], [yaw], observed.figures.yaw_sd
            )
            book.take(
                lambda x: show_position(observed.p, x, 0.0, 0.0),
                d.position[k],
                observed.figures.position_sd,
            )
    # the wheels' noise is that of wheels without slip: a share of the slip smaller
    np.testing.assert_allclose(now.estimate, book.x[:, 0], atol=2e-6)
    np.testing.assert_allclose(now.covariance, book.P, rtol=1e-2, atol=1e-8)


@pytest.mark.parametrize("late", [1, 7, 40])
def test_late_samples_give_what_they_would_have_given_in_time(late):
    in_time, behind = (Observed(robot(**MANY)) for _ in range(2))
    d = drive(in_time.p, in_time.figures, N)
    for k in range(N):
        due = k if k % 5 == 2 else None
        first = feed(in_time, d, k, position=due, yaw=due)
        old = k - late if k >= late and (k - late) % 5 == 2 else None
        feed(behind, d, k, position=old, yaw=old)
        m = behind.moment()
    for k in range(N, N + late):  # what is still on its way
        d_k = N - 1
        old = k - late if (k - late) % 5 == 2 else None
        at = d.times[d_k] + (k - d_k) * DT_S
        sample = {} if old is None else {
            "position": (d.times[old], *d.position[old]), "yaw": (d.times[old], d.yaw[old])
        }  # fmt: skip
        behind.step(at, *d.read[d_k], **sample)
    m = behind.moment(late)
    np.testing.assert_array_equal(m.estimate, first.estimate)
    np.testing.assert_array_equal(m.covariance, first.covariance)


def test_what_is_too_old_is_counted_and_changes_nothing():
    one, other = (Observed(robot()) for _ in range(2))
    d = drive(one.p, one.figures, N)
    for k in range(N):
        due = k if k % 5 == 0 else None
        feed(one, d, k, position=due, yaw=due)
        feed(other, d, k, position=due, yaw=due)
    at = d.times[-1] + DT_S
    one.step(at, 0.0, 0.0, position=(at - 1.1, 50.0, 50.0))
    other.step(at, 0.0, 0.0)
    assert one.head.late == 1.0
    np.testing.assert_array_equal(one.moment().estimate, other.moment().estimate)


def test_an_outlier_is_refused_and_counted():
    one, other = (Observed(robot()) for _ in range(2))
    d = drive(one.p, one.figures, N)
    for k in range(N):
        due = k if k % 5 == 0 else None
        feed(one, d, k, position=due, yaw=due)
        feed(other, d, k, position=due, yaw=due)
    d.position[N - 1] += 3.0
    m = feed(one, d, N - 1, position=N - 1)
    assert one.head.rejected == other.head.rejected + 1.0
    assert m.nis > GATE_2 / 2.0
    assert m.refused[PLACE] == 1.0


def test_a_robot_that_was_carried_is_found_again():
    observed = Observed(robot(), readmit_after=6)
    d = drive(observed.p, observed.figures, 2 * N)
    d.position[N:] += [4.0, -2.0]
    errors = []
    for k in range(2 * N):
        due = k if k % 5 == 0 else None
        m = feed(observed, d, k, position=due, yaw=due)
        moved = np.array([4.0, -2.0]) if k >= N else np.zeros(2)
        errors.append(float(np.abs(m.estimate[:2] - d.truth[k, :2] - moved).max()))
    assert observed.head.readmitted == 1.0
    assert max(errors[20:N]) < 0.3
    assert errors[N + 5] > 1.0
    assert max(errors[N + 40 :]) < 0.3


def test_a_robot_that_its_wheels_can_have_taken_there_was_not_carried():
    """After a silence with a wrong model the estimate is off, and the next sample corrects it."""
    observed = Observed(robot(), unknown={})
    strange = Observed(robot(wheel_radius=0.3, rotation_gain=-0.3))
    d = drive(strange.p, strange.figures, 3 * N)
    silent, first = range(N, 2 * N + 50), 2 * N + 50
    errors = []
    for k in range(3 * N):
        due = k if k % 5 == 0 and k not in silent else None
        m = feed(observed, d, k, position=due, yaw=due)
        errors.append(float(np.hypot(*(m.estimate[:2] - d.truth[k, :2]))))
    assert errors[first - 1] > 0.5
    assert errors[first] < 0.2
    assert observed.head.readmitted == 0.0
    assert observed.head.doubted >= 1.0
    np.testing.assert_allclose(m.covariance, m.covariance.T, rtol=1e-9, atol=1e-12)
    assert np.linalg.eigvalsh(m.covariance).min() > -1e-12


def test_outliers_that_do_not_agree_move_nothing():
    observed = Observed(robot(), readmit_after=6)
    d = drive(observed.p, observed.figures, 2 * N)
    wild = np.random.default_rng(1).uniform(-50.0, 50.0, (N, 2))
    d.position[N : 2 * N - 50] += wild[: N - 50]
    for k in range(2 * N):
        due = k if k % 5 == 0 else None
        m = feed(observed, d, k, position=due, yaw=due)
        assert k < 20 or np.hypot(*(m.estimate[:2] - d.truth[k, :2])) < 0.5
    assert observed.head.readmitted == 0.0
    assert observed.head.rejected >= 25.0


def test_a_robot_that_was_turned_by_hand_is_found_again():
    observed, still = Observed(robot(), readmit_after=6), np.zeros((2 * N, 2))
    d = drive(observed.p, observed.figures, 2 * N, exact=still)
    d.yaw[N:] += 2.0
    for k in range(2 * N):
        due = k if k % 5 == 0 else None
        m = feed(observed, d, k, position=due, yaw=due)
    assert observed.head.readmitted == 1.0
    assert abs(m.estimate[YAW] - d.truth[-1, 2] - 2.0) < 0.1


def test_the_first_heading_is_taken_as_the_tag_shows_it():
    """Derivatives near a heading that means nothing would place the robot wrongly, and surely."""
    for seed in range(4):
        observed = Observed(robot(**MANY))
        d = drive(observed.p, observed.figures, 60, seed)
        for k in range(60):
            due = k if k % 5 == 0 else None
            feed(observed, d, k, position=due, yaw=due)
        assert observed.head.rejected == 0.0


def test_nothing_is_known_before_the_first_sample():
    observed = Observed(robot())
    d = drive(observed.p, observed.figures, 50)
    for k in range(50):
        m = feed(observed, d, k)
    assert m.fixed.tolist() == [0.0, 0.0]
    assert m.covariance[0, 0] > 1e5
    assert m.estimate[V] == pytest.approx(d.truth[-1, 3], abs=0.05)
    assert m.estimate[OM] == pytest.approx(d.truth[-1, 4], abs=0.05)
    m = feed(observed, d, 49, position=49, yaw=49)
    assert m.fixed.tolist() == [1.0, 1.0]


def test_a_gyro_that_came_between_two_moments_is_read_at_its_time():
    """Or a robot that turns ever faster would seem to have a gyro that shows too much."""
    observed, n = Observed(robot(), unknown={"gyro_bias": 0.02}), 100
    turn = 0.04 * np.arange(n)
    d = drive(observed.p, observed.figures, n, exact=np.column_stack([-turn, -turn]))
    for k in range(1, n):
        grown = 0.25 * (d.truth[k, 4] - d.truth[k - 1, 4])
        between = (d.times[k] - 0.25 * DT_S, d.truth[k, 4] - grown)
        m = observed.step(d.times[k], *(2 * [-turn[k]]), gyro=between)
    assert abs(m.estimate[BIAS]) < 0.1 * grown

"""The smoother beside filterpy's, and what it gains."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from hilserver.observer.layout import YAW
from hilserver.observer.offline import GYRO, HEADING, POSITION, MeasuredSeries, run
from hilserver.observer.smoother import smooth
from tests.observer.rig import MANY, Observed, drive, numerical, robot
from tests.observer.test_motion import moved

N = 300


def series(d, every=5, cut=None):
    rows = []
    for k, at in enumerate(d.times):
        rows.append((GYRO, at, d.gyro[k], 0.0))
        if k % every == 0 and (cut is None or not cut[0] <= k < cut[1]):
            rows += [(HEADING, at, d.yaw[k], 0.0), (POSITION, at, *d.position[k])]
    wheels = np.column_stack([d.times, d.read, np.zeros((len(d.times), 3))])
    return MeasuredSeries(wheels, np.array(rows))


def test_a_series_gives_what_its_samples_give_one_by_one():
    observed = Observed(robot(**MANY))
    d = drive(observed.p, observed.figures, N)
    course = run(observed.p, observed.c, series(d))
    for k in range(N):
        at, due = d.times[k], k % 5 == 0
        m = observed.step(
            at,
            *d.read[k],
            gyro=(at, d.gyro[k]),
            position=(at, *d.position[k]) if due else None,
            yaw=(at, d.yaw[k]) if due else None,
        )
    np.testing.assert_array_equal(course.estimate[-1], m.estimate)
    np.testing.assert_array_equal(course.covariance[-1], m.covariance)


def test_smoother_is_that_of_filterpy():
    """With F and Q of every step by numerical derivatives and by what the filter added."""
    observed = Observed(
        robot(),
        unknown=dict.fromkeys(("rotation_gain", "wheel_radius", "gyro_bias"), 0.01),
    )
    steady = np.full((60, 2), [5.0, -3.0])
    d = drive(observed.p, observed.figures, 60, exact=steady)
    s = series(d)
    course = run(observed.p, observed.c, s)
    x, m = smooth(observed.p, observed.c, s, course)
    fs, qs, ps = [np.eye(11)], [np.zeros((11, 11))], course.covariance
    from hilserver.observer.layout import Head, Moment  # noqa: PLC0415
    from hilserver.observer.motion import bend, predict  # noqa: PLC0415

    predicted = []
    for k in range(59):
        a, b = Moment.zeros(), Moment.zeros()
        a.time, b.time = s.wheels[k, 0], s.wheels[k + 1, 0]
        (a.left, a.right), (b.left, b.right) = s.wheels[k, 1:3], s.wheels[k + 1, 1:3]
        a.estimate[:] = course.estimate[k]
        a.covariance[:] = course.covariance[k]
        if k > 0:
            bend(*s.wheels[k - 1, :3], a, b)
        predict(observed.p, observed.c, Head.zeros(), a, b)
        predicted.append(b.estimate.copy())

        def one(y, a=a, b=b):
            return moved(observed, a, b, y)

        f = numerical(one, course.estimate[k])
        fs.append(f)
        qs.append(b.covariance - f @ course.covariance[k] @ f.T)
    xs, back = course.estimate.copy(), ps.copy()
    for k in range(58, -1, -1):
        book = KalmanFilter(dim_x=11, dim_z=1)
        book.x = np.zeros(11)
        # filterpy's smoother is linear: about the estimate of k, the state moves to `predicted`
        pair = np.array([np.zeros(11), xs[k + 1] - predicted[k]])
        result, covariance, _, _ = book.rts_smoother(
            pair, np.array([ps[k], back[k + 1]]), Fs=fs[k : k + 2], Qs=qs[k : k + 2]
        )
        xs[k] = course.estimate[k] + result[0]
        back[k] = covariance[0]
    np.testing.assert_allclose(x[5:], xs[5:], atol=2e-5)
    np.testing.assert_allclose(m[5:, :3, :3], back[5:, :3, :3], atol=2e-6)


def test_smoothing_bridges_a_cut():
    """Without navigation for 4 s the smoother is nearer than the filter, and says so."""
    observed = Observed(robot(**MANY))
    errors, gains = [], []
    for seed in range(6):
        d = drive(observed.p, observed.figures, N, seed)
        s = series(d, cut=(80, 280))
        course = run(observed.p, observed.c, s)
        x, m = smooth(observed.p, observed.c, s, course, first=5)
        part = slice(80, 280)
        errors.append([
            float(np.hypot(*(e[part, :2] - d.truth[part, :2]).T).mean())
            for e in (course.estimate, x)
        ])  # fmt: skip
        gains.append(m[279, 0, 0] < course.covariance[279, 0, 0])
        assert np.cos(x[part, YAW] - d.truth[part, 2]).min() > 0.99
    filtered, smoothed = np.mean(errors, axis=0)
    assert smoothed < 0.8 * filtered
    assert all(gains)
    assert np.linalg.eigvalsh(m[200]).min() == pytest.approx(0.0, abs=1e-6)


def test_smoothing_does_not_cross_a_robot_that_was_carried():
    """Where it was put down says nothing about where it was before."""
    observed = Observed(robot(), readmit_after=6)
    d = drive(observed.p, observed.figures, N)
    d.position[150:] += [4.0, -2.0]
    course = run(observed.p, observed.c, series(d))
    (put,) = np.flatnonzero(course.carried)
    assert put > 150
    x, m = smooth(observed.p, observed.c, series(d), course, first=5)
    np.testing.assert_array_equal(x[put - 1], course.estimate[put - 1])
    np.testing.assert_array_equal(m[put - 1], course.covariance[put - 1])
    for part, by in ((slice(5, 150), 0.0), (slice(put, N), np.array([4.0, -2.0]))):
        assert np.hypot(*(x[part, :2] - d.truth[part, :2] - by).T).max() < 0.2

"""Uncertain parameters are considered: they enlarge what is unknown and are not estimated away."""

from dataclasses import replace

import numpy as np
import pytest

from hilserver.observer.consider import alternatives, directions
from hilserver.observer.figures import figures
from hilserver.observer.layout import N_ESTIMATED
from hilserver.plant.packing import pack
from tests.observer.rig import MANY, NOISE, Observed, drive, robot

NAMES = ["rotation_gain", "side_slip", "saturation_limit", "nav_scale", "nav_latency"]
SD = np.array([0.01, 0.03, 2.0, 0.01, 0.01])


def covariance():
    correlation = np.eye(5)
    correlation[0, 1] = correlation[1, 0] = 0.8
    return correlation * np.outer(SD, SD)


def test_directions_have_the_covariance_of_the_parameters():
    machine = robot(rotation_gain=0.03, side_slip=0.1, nav_latency=0.1)
    base, moved = pack(machine), directions(machine, NAMES, covariance())
    gain = np.array([m.yaw_gain / base.yaw_gain - 1.0 for m in moved]) * 1.03
    slip = np.array([m.side_slip - base.side_slip for m in moved])
    scale = np.array([m.nav_scale - base.nav_scale for m in moved])
    assert np.sqrt(gain @ gain) == pytest.approx(0.01)
    assert np.sqrt(slip @ slip) == pytest.approx(0.03)
    assert gain @ slip == pytest.approx(0.8 * 0.01 * 0.03)
    assert scale @ gain == pytest.approx(0.0, abs=1e-12)
    assert {m.limit for m in moved} == {base.limit}  # the drives' limit is not seen


def test_parameters_that_cannot_be_seen_give_no_direction():
    assert directions(robot(), ["saturation_limit", "no_term"], np.eye(2)) == []


def test_a_value_at_the_end_of_its_range_stays_in_it():
    machine = robot(nav_latency=0.0)
    (moved,) = directions(machine, ["nav_latency"], np.array([[1e-4]]))
    assert moved.nav_delay >= 0.0


def run(observed, d, n, every=5):
    for k in range(n):
        at, due = d.times[k], k % every == 0
        m = observed.step(
            at,
            *d.read[k],
            gyro=(at, d.gyro[k]),
            position=(at, *d.position[k]) if due else None,
            yaw=(at, d.yaw[k]) if due else None,
        )
    return m


def test_uncertain_parameters_only_enlarge_the_covariance():
    machine = robot(**MANY)
    moved = directions(machine, NAMES, covariance())
    sure, unsure = Observed(machine), Observed(machine, moved)
    d = drive(sure.p, sure.figures, 300)
    a, b = run(sure, d, 300).covariance, run(unsure, d, 300).covariance
    assert (np.diag(b)[:3] > np.diag(a)[:3]).all()
    assert np.linalg.eigvalsh(b).min() > -1e-12


def test_the_gain_is_schmidts():
    """One sample beside the textbook with the directions as states whose gain is zero."""
    machine = robot(**MANY)
    moved = directions(machine, NAMES, covariance())
    observed, n = Observed(machine, moved), len(moved)
    d = drive(observed.p, observed.figures, 60)
    before = run(observed, d, 59, every=7).copy()
    root = np.block([
        [before.covariance, before.cross[:, :n]],
        [before.cross[:, :n].T, np.eye(n)],
    ])  # fmt: skip
    assert np.linalg.eigvalsh(root).min() > -1e-9
    h = np.zeros(N_ESTIMATED + n)
    h[4], h[5] = observed.p.gyro_gain, 1.0
    h[N_ESTIMATED:] = [
        (m.gyro_gain - observed.p.gyro_gain) * before.estimate[4] for m in moved
    ]
    # gyro_scale is not among the uncertain ones
    assert np.abs(h[N_ESTIMATED:]).max() == 0.0
    r = observed.figures.gyro_sd**2
    s = h @ root @ h + r
    gain = root @ h / s
    gain[N_ESTIMATED:] = 0.0
    keep = np.eye(len(h)) - np.outer(gain, h)
    expected = keep @ root @ keep.T + r * np.outer(gain, gain)
    from hilserver.observer.correction import take_gyro  # noqa: PLC0415
    from hilserver.observer.layout import Head  # noqa: PLC0415

    after = before.copy()
    after.gyro = d.gyro[58]
    take_gyro(observed.p, observed.c, Head.zeros(), after, 0.02)
    np.testing.assert_allclose(
        after.covariance, expected[:N_ESTIMATED, :N_ESTIMATED], atol=1e-9
    )
    np.testing.assert_allclose(
        after.cross[:, :n], expected[:N_ESTIMATED, N_ESTIMATED:], atol=1e-9
    )


def test_errors_of_wrong_parameters_are_within_what_is_said():
    """Drives of robots whose parameters are drawn from the covariance, seen with the mean ones."""
    rng, machine, squares = (
        np.random.default_rng(3),
        robot(rotation_gain=0.03, side_slip=0.1),
        [],
    )
    names, sd = (
        ["rotation_gain", "side_slip", "nav_scale"],
        np.array([0.02, 0.05, 0.02]),
    )
    moved = directions(machine, names, np.diag(sd**2))
    for seed in range(60):
        terms = dict(machine.terms)
        for name, by in zip(names, sd * rng.standard_normal(3), strict=True):
            terms[name] = terms.get(name, 0.0) + by
        true = replace(machine, terms=terms)
        observed = Observed(machine, moved, unknown={})
        d = drive(pack(true), observed.figures, 250, seed)
        m = run(observed, d, 250)
        error = m.estimate[:3] - d.truth[-1, :3]
        error[2] = np.angle(np.exp(1j * error[2]))
        squares.append(error @ np.linalg.solve(m.covariance[:3, :3], error))
    assert 2.0 < np.mean(squares) < 4.2  # 3 with 5 and 95 % limits of the mean of 60


def test_noise_of_the_rig_has_every_channel():
    assert len(NOISE) == 8


def test_what_a_diagnosis_cannot_tell_apart_is_a_direction():
    """The heading's frame or the toe of the wheels: half the square of what the other changes."""
    machine = robot(nav_frame_yaw=-0.03, rotation_gain=0.02)
    group = {"nav_frame_yaw": -0.03, "wheel_misalignment": 0.03}
    (other,) = alternatives(machine, [group, {"gyro_scale": 0.1, "no_term": 1.0}])
    base = pack(machine)
    assert other.nav_frame_yaw - base.nav_frame_yaw == pytest.approx(0.03 / 2**0.5)
    assert other.misalignment == pytest.approx(0.03 / 2**0.5)
    assert other.yaw_gain == base.yaw_gain
    assert np.isfinite(other.numbers).sum() == np.isfinite(base.numbers).sum()


def test_what_has_no_name_lets_slip_and_gain_wander():
    machine, unseen = robot(), {"rotation_gain": 0.2, "wheel_radius": 0.1}
    calm = figures(machine, {}, unknown=unseen)
    loose = figures(machine, {}, unknown=unseen, wanders=True)
    assert (calm.gain_sd, calm.gain_walk) == (0.1, 0.0)
    assert (loose.gain_sd, loose.gain_walk) == (0.1, pytest.approx(0.1**2 / 60.0))

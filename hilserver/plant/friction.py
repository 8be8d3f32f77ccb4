"""Quasi-static turning of four wheels with anisotropic Coulomb friction (friction_anisotropy).

While the sides roll at ``v0 +- delta``, the body moves so that the friction forces at the four
contacts balance. The friction dissipates ``sum N_i sqrt(s_x^2 + mu^2 s_y^2)``, with s the slip of a
contact and mu the ratio of the friction across the wheels to that along them; the balance is the
minimum of this convex function. Slip does not depend on v0, so turn rate and lateral speed are
proportional to delta: the term is a constant factor on K_om and a constant shift of X_ICR. With
mu = 1 and the centre of mass in the wheels' centre the result is ``K_om = l_y/(l_x^2 + l_y^2)``
(5.9), whatever the friction and mass.
"""

import numpy as np
from numpy.typing import NDArray

from hilserver.plant.tyre import slip_size

_STEPS = 200
_SMOOTHING = 1e-9  # slip, as a share of delta, below which friction fades


def _slip(
    wheelbase_m: float, track_m: float, offset_m: float, turn: NDArray[np.float64]
) -> tuple[
    NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]
]:
    """Return the slips along and across, positions x and loads of the contacts fl, fr, rl, rr."""
    ahead = np.array([0.5, 0.5, -0.5, -0.5]) * wheelbase_m - offset_m
    aside = np.array([0.5, -0.5, 0.5, -0.5]) * track_m
    share = 0.5 + np.array([1, 1, -1, -1]) * offset_m / wheelbase_m
    om, vy = turn
    return -om * aside + np.sign(aside), vy + om * ahead, ahead, share


def balance(
    wheelbase_m: float, track_m: float, ratio: float, offset_m: float
) -> tuple[float, float]:
    """Return K_om [1/m] and X_ICR [m] of the quasi-static balance.

    Parameters
    ----------
    wheelbase_m, track_m : float
        l_x and l_y.
    ratio : float
        Friction across the wheels divided by friction along them.
    offset_m : float
        Centre of mass in front of the wheels' centre, below half the wheelbase.
    """
    aside = np.array([0.5, -0.5, 0.5, -0.5]) * track_m
    # per delta = 1 m/s
    turn = np.array([2 * track_m / (wheelbase_m**2 + track_m**2), 0.0])

    def loss(at: NDArray[np.float64]) -> float:
        along, across, _, share = _slip(wheelbase_m, track_m, offset_m, at)
        return float(
            np.sum(share * slip_size.py_func(along, across, ratio, _SMOOTHING))
        )

    for _ in range(_STEPS):
        along, across, ahead, share = _slip(wheelbase_m, track_m, offset_m, turn)
        size = slip_size.py_func(along, across, ratio, _SMOOTHING)
        d_along = np.stack([-aside, np.zeros(4)])
        d_across = np.stack([ahead, np.ones(4)])
        inner = along * d_along + ratio**2 * across * d_across
        gradient = (share * inner / size).sum(axis=1)
        outer = np.einsum("ik,jk->ijk", d_along, d_along)
        outer = outer + ratio**2 * np.einsum("ik,jk->ijk", d_across, d_across)
        curved = outer / size - np.einsum("ik,jk->ijk", inner, inner) / size**3
        step = -np.linalg.solve(
            (share * curved).sum(axis=2) + 1e-15 * np.eye(2), gradient
        )
        length = 1.0
        while loss(turn + length * step) > loss(turn) and length > 1e-12:
            length *= 0.5
        turn = turn + length * step
        if float(np.max(np.abs(length * step))) < 1e-15:
            break
    om, vy = turn
    return 0.5 * abs(float(om)), -float(vy) / float(om)


def anisotropy(
    wheelbase_m: float, track_m: float, ratio: float, offset_m: float
) -> tuple[float, float]:
    """Return the factor on K_om and the shift of X_ICR [m]; exactly (1, 0) at null."""
    if ratio == 1.0 and offset_m == 0.0:
        return 1.0, 0.0
    gain, icr_m = balance(wheelbase_m, track_m, ratio, offset_m)
    return gain * (wheelbase_m**2 + track_m**2) / track_m, icr_m

"""The tyre law that the planar plant and the mechatronic model share.

On a contact with the normal force N and the slip (s, t), along and across the direction in which
the tyre grips, acts the force::

    F = -mu N (s, rho^2 t) / sqrt(s^2 + (rho t)^2 + v0^2)

with mu the friction along, rho mu that across, and v0 the slip [m/s] below which the friction
fades. It is the gradient of the dissipation ``mu N sqrt(s^2 + (rho t)^2 + v0^2)``, so it never
drives. `friction_anisotropy` is its limit v0 -> 0; a mecanum wheel grips along the axis of its
rollers and has rho = 0, because across it they roll.
"""

from typing import Any

import numpy as np

from hilserver.compiled import inlined


@inlined
def slip_size(along: Any, across: Any, ratio: float, v0: float) -> Any:
    """Return ``sqrt(s^2 + (rho t)^2 + v0^2)``; scalars or arrays."""
    return np.sqrt(along**2 + (ratio * across) ** 2 + v0**2)


@inlined
def traction(along: Any, across: Any, ratio: float, v0: float) -> Any:
    """Return both parts of the force as a share of ``mu N``."""
    size = slip_size(along, across, ratio, v0)
    return -along / size, -(ratio**2) * across / size

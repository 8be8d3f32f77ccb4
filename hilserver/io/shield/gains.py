"""Gains of the wheel speed controller that come in while the robot runs."""

import dataclasses
import math

from hilserver.image import Row
from hilserver.io.shield.status import NAME
from hilserver.io.world import World


class Gains:
    """Makes what a host sets the gains of the plant's controller."""

    def __init__(self, world: World) -> None:
        self._gate, self._image, self._table = world.gate, world.image, world.table
        self._loop, self._period_s = world.robot.loop, world.robot.period_s

    def apply(self, k_p: float, k_i: float) -> None:
        """Latch gains [%/rpm], [%/(rpm s)] at the next tick; NaN: as configured.

        Raises
        ------
        ValueError
            If another source has control, or the loop would not be stable.
        """
        if self._gate.owner != NAME:
            raise ValueError(f"gains are not taken over: '{self._gate.owner}' has control")
        k_p = self._loop.k_p if math.isnan(k_p) else k_p
        k_i = self._loop.k_i if math.isnan(k_i) else k_i
        loop = dataclasses.replace(self._loop, k_p=k_p, k_i=k_i)
        if k_p < 0.0 or k_i < 0.0 or not loop.is_stable(self._period_s):
            raise ValueError(f"gains are not taken over: kp {k_p:g}, ki {k_i:g} are not stable")
        values = {"internal.gains": 1.0, "internal.k_p": k_p, "internal.k_i": k_i}
        self._image.push([Row(self._table.slot(name), value) for name, value in values.items()])

"""The battery: state of charge and inner resistance of a NiMH pack of 16 cells (19.2 V nominal).

``V = E(charge) - R I``, ``I = idle + per-duty current of the four wheels``, clipped to the range of
the pack (4.2: 17.5 .. 23.5 V). E is flat in the middle and falls at the end, as in NiMH cells. The
currents and the resistance are assumptions. The drive of the base model ignores the voltage.
"""

from typing import Final

import numpy as np

from hilserver.compiled import inlined, part
from hilserver.plant.layout import N_WHEELS, Inputs, Outputs, Parameters, State, Status
from hilserver.status import BAD_OUT_OF_SERVICE, GOOD

LOWEST_V: Final = 17.5
HIGHEST_V: Final = 23.5
DUTY_FULL_PCT: Final = 100.0
_CHARGE: Final = np.array([0.0, 0.05, 0.2, 0.5, 0.8, 0.95, 1.0])
_EMF_V: Final = np.array([17.5, 18.6, 19.4, 20.2, 21.0, 22.2, 23.5])


@inlined
def open_circuit_voltage(charge: float) -> float:
    """Return the voltage [V] without load at a charge of 0 .. 1, linear between the points."""
    for k in range(1, _CHARGE.shape[0]):
        if charge <= _CHARGE[k]:
            share = max(charge - _CHARGE[k - 1], 0.0) / (_CHARGE[k] - _CHARGE[k - 1])
            return float(_EMF_V[k - 1] + share * (_EMF_V[k] - _EMF_V[k - 1]))
    return HIGHEST_V


@inlined
def drawn_current(p: Parameters, y: Outputs) -> float:
    """Return the current [A] of electronics and wheels under the duties of this tick."""
    current = p.idle_current
    for i in range(N_WHEELS):
        current += p.duty_current * abs(y.duty[i])
    return float(current)


@part
def battery_step(p: Parameters, x: State, u: Inputs, y: Outputs, q: Status) -> None:  # noqa: ARG001 (one shape)
    """Publish the voltage under the load of this tick and subtract the charge used in one run."""
    if p.battery_enabled == 0.0:
        q.battery = q.current = BAD_OUT_OF_SERVICE
        return
    current = drawn_current(p, y)
    voltage = open_circuit_voltage(x.charge) - p.resistance * current
    x.battery_v = min(max(voltage, LOWEST_V), HIGHEST_V)
    y.battery, y.current = x.battery_v, current
    q.battery = q.current = GOOD
    x.charge = max(x.charge - p.charge_per_a * current, 0.0)

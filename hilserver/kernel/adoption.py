"""Checks a state before the step continues from it, because the step checks no index itself."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

import hilserver.kernel.modifier_layout as at
from hilserver.image.layout import Region
from hilserver.kernel.modifier_layout import Modifiers
from hilserver.plant.layout import RING, State

_ANY = 2**63
_ENTRY: Mapping[str, tuple[int, int]] = {
    "kind": (min(at.Kind), max(at.Kind)),
    "side": (at.INPUT, at.NEITHER),
    "every": (1, _ANY),
    "ticks": (0, at.MAX_DELAY_TICKS),
    "spread": (0, at.MAX_DELAY_TICKS),
    "ring": (-1, at.MAX_RINGS - 1),
}
"""Least and largest value of the fields of a fault's entry."""


def unfit(
    state: NDArray[np.int64], regions: Mapping[str, Region], n_slots: int
) -> str | None:
    """Return what in a state would break the step, None if it is sound.

    Parameters
    ----------
    state : ndarray of int64
        The live regions, as in a snapshot or a recording.
    regions : mapping of Region
        Regions of the image that is to adopt the state.
    """
    base = regions["live"].base

    def part(name: str) -> NDArray[np.int64]:
        return state[regions[name].base - base :][: regions[name].length]

    if "x" in regions:
        x = State.of(part("x"))
        if not all(
            0 <= head < RING for head in (x.setpoint_head, x.imu_head, x.nav_head)
        ):
            return "place in a ring of samples"
        if not all(0 <= count <= RING for count in (x.imu_count, x.nav_count)):
            return "number of samples"
    if "modifiers" in regions:
        return _unfit_faults(Modifiers.of(part("modifiers")), n_slots)
    return None


def _unfit_faults(m: Modifiers, n_slots: int) -> str | None:
    if not (
        0 <= m.count <= at.MAX_MODIFIERS and 0 <= m.touched <= 2 * at.MAX_MODIFIERS
    ):
        return "number of faults"
    slots = m.slots[: m.touched].tolist()
    for entry in m.entries[: m.count]:
        slots += [entry.slot, entry.other]
        for name, (low, high) in _ENTRY.items():
            if not low <= entry[name] <= high:
                return f"'{name}' of a fault"
    return None if all(0 <= slot < n_slots for slot in slots) else "signal of a fault"

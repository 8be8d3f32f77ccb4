"""A parameter with default, bounds, unit and meaning, shared by configuration and plant."""

import math
import operator
from collections.abc import Callable, Iterator, Mapping
from dataclasses import field, fields
from typing import Any, Final

_BOUNDS: Final[Mapping[str, tuple[Callable[[float, float], bool], str]]] = {
    "gt": (operator.gt, "must be above {:g}"),
    "ge": (operator.ge, "must be at least {:g}"),
    "lt": (operator.lt, "must be below {:g}"),
    "le": (operator.le, "must be at most {:g}"),
}


_UNITS: Final = {
    "n_s2_m2": "N·s²/m²",
    "rad_s": "rad/s",
    "m_s2": "m/s²",
    "m_s": "m/s",
    "rad": "rad",
    "rpm": "rpm",
    "ohm": "ohm",
    "pct": "%",
    "nm": "N·m",
    "kg": "kg",
    "ah": "Ah",
    "hz": "Hz",
    "m": "m",
    "s": "s",
    "a": "A",
}
"""Symbol of the unit by the ending of a name; longer endings first."""


def unit_of(name: str) -> str:
    """Return the symbol of the unit in which a name ends, "1" without one."""
    return next((unit for end, unit in _UNITS.items() if name.endswith(f"_{end}")), "1")


def quantity(
    default: float | None,
    meaning: str,
    *,
    unit: str = "",
    jumps: str = "",
    **bounds: float,
) -> Any:
    """Return the field of a dataclass.

    Parameters
    ----------
    unit : str
        Its symbol, if the name does not end in the unit.
    jumps : str
        Which outputs jump when it changes, see `hilserver.parameters.table`; "fixed": it cannot be
        changed while the robot runs.
    **bounds : float
        ``gt``, ``ge``, ``lt``, ``le``: above, at least, below, at most.
    """
    about = {"meaning": meaning, "bounds": bounds, "unit": unit, "jumps": jumps}
    return field(default=default, metadata=about)


def refused(part: Any) -> Iterator[tuple[str, float, str]]:
    """Yield name, value and requirement of every number of a dataclass that is out of bounds."""
    for item in fields(part):
        value = getattr(part, item.name)
        if isinstance(value, int | float) and not isinstance(value, bool):
            wanted = _wanted(item.metadata.get("bounds", {}), value)
            if wanted is not None:
                yield item.name, value, wanted


def _wanted(bounds: Mapping[str, float], value: float) -> str | None:
    if not math.isfinite(value):
        return "must be a finite number"
    for name, bound in bounds.items():
        holds, wanted = _BOUNDS[name]
        if not holds(value, bound):
            return (
                "must not be negative"
                if (name, bound) == ("ge", 0)
                else wanted.format(bound)
            )
    return None

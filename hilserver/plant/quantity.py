"""A parameter with its default, its bounds and its meaning: what configuration and plant share."""

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


def quantity(default: float | None, meaning: str, **bounds: float) -> Any:
    """Return the field of a dataclass.

    Parameters
    ----------
    meaning : str
        With the unit where the name does not end in it.
    **bounds : float
        ``gt``, ``ge``, ``lt``, ``le``: above, at least, below, at most.
    """
    return field(default=default, metadata={"meaning": meaning, "bounds": bounds})


def refused(part: Any) -> Iterator[tuple[str, float, str]]:
    """Yield name, value and what it must be of every number of a dataclass that cannot be."""
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
            return "must not be negative" if (name, bound) == ("ge", 0) else wanted.format(bound)
    return None

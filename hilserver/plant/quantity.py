"""A parameter with its default, its bounds and its meaning: what configuration and plant share."""

import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import Field, field
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


def refusal(item: "Field[Any]", value: float) -> str | None:
    """Return why a number cannot be the value of a field; None if it can."""
    if not math.isfinite(value):
        return "must be a finite number"
    for name, bound in item.metadata.get("bounds", {}).items():
        holds, wanted = _BOUNDS[name]
        if not holds(value, bound):
            return "must not be negative" if (name, bound) == ("ge", 0) else wanted.format(bound)
    return None

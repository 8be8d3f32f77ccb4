"""Numbers in messages by their path: ``a.b.c``, ``list[2]``, ``velocity[left_wheel]``, yaw."""

import dataclasses
import math
import re
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from hilserver.errors import meant
from hilserver.measured.thresholds import UNIT_NORM

NOT_MEASURED: Final = -1.0
"""First element of a covariance of sensor_msgs/Imu if the sensor does not measure the quantity."""

WITHOUT_FIX: Final = -1
"""Status of sensor_msgs/NavSatFix if there is no fix."""

_STEP: Final = re.compile(r"\.?([A-Za-z_]\w*)|\[([^\]]+)\]")
_OWN_NAMES: Final = ("child_frame_id", "name", "key")
"""Attributes that name the elements of a list, if there is no list of names next to it."""


@dataclasses.dataclass(frozen=True, slots=True)
class _Index:
    key: int | str


class _AbsentError(Exception):
    """A message does not hold the field."""


class Field:
    """Reads one number of every message of a topic."""

    def __init__(self, path: str) -> None:
        self.path = path
        # messages that did not hold it, and why the first one did not
        self.absent = 0
        self.reason = ""
        self._may_be_absent = False
        self._steps: list[str | _Index] = []
        self._at: dict[int, dict[str, None]] = {}
        end = 0
        while end < len(path) and (match := _STEP.match(path, end)):
            name, index = match.groups()
            number = int(index) if index is not None and index.isdecimal() else index
            self._steps.append(name if name is not None else _Index(number))
            end = match.end()
        if end < len(path) or not self._steps:
            self._steps = [path]

    def __call__(self, message: Any) -> float:
        """Return the number; NaN if the message does not hold it.

        It is also NaN if its covariance marks it as not measured (sensor_msgs/Imu), or the message
        says that there is no fix (sensor_msgs/NavSatFix).
        """
        status = getattr(message, "status", None)
        if getattr(status, "status", 0) == WITHOUT_FIX:
            self._gone(lambda: "its status says that there is no fix", is_mistake=False)
            return math.nan
        covariance = getattr(message, f"{self._steps[0]}_covariance", None)
        if isinstance(covariance, np.ndarray | list) and list(covariance[:1]) == [
            NOT_MEASURED
        ]:
            return math.nan
        try:
            return self._number(message)
        except _AbsentError:
            return math.nan

    def transform(self, message: Any) -> Any:
        """Return the transform of a tf2_msgs/TFMessage that the path names; None if it has none."""
        match self._steps:
            case ["transforms", _Index(key), *_]:
                items = message.transforms
                names = names_of(message, items)
                place = names.index(key) if key in names else key
                is_there = isinstance(place, int) and place < len(items)
                return items[place] if is_there else None
        return None

    def mistake(self, n: int) -> str | None:
        """Return what is wrong with the path after `n` messages, or None."""
        if self.absent == n and not self._may_be_absent:
            return self.reason
        for place, found in self._at.items():
            if len(found) > 1:
                one, other = list(found)[:2]
                better = self.path.replace(f"[{place}]", f"[{one}]", 1)
                return (
                    f"field '{self.path}' is '{one}' in some messages and '{other}' in others;"
                    f" select it by name, as {better}"
                )
        return None

    def _gone(
        self, reason: Callable[[], str], *, is_mistake: bool = True
    ) -> _AbsentError:
        """Count a message that does not hold the field; the first one gives the reason."""
        self.absent += 1
        self.reason = self.reason or reason()
        self._may_be_absent |= not is_mistake
        return _AbsentError()

    def _number(self, message: Any) -> float:
        holder, value = None, message
        for step in self._steps:
            if isinstance(step, _Index):
                value = self._element(holder, value, step.key)
            elif step == "yaw" and hasattr(value, "w"):
                return self._yaw(value)
            elif not hasattr(value, step):
                raise self._gone(
                    lambda: f"there is no field '{self.path}'; {self._hint(message)}"
                )
            else:
                holder, value = value, getattr(value, step)
        if value is None:
            raise self._gone(lambda: f"field '{self.path}' is empty", is_mistake=False)
        try:
            return float("list" if isinstance(value, np.ndarray) else value)
        except (TypeError, ValueError):
            raise self._gone(
                lambda: f"field '{self.path}' is not a number; choose one that is"
            ) from None

    def _hint(self, message: Any) -> str:
        known = _fields(message)
        return meant(self.path, known, f"it has {', '.join(known):.200}")

    def _element(self, holder: Any, items: Any, key: int | str) -> Any:
        names = names_of(holder, items)
        if isinstance(key, str) and key not in names:
            known = f"it has {', '.join(names):.200}" if names else "indices start at 0"
            raise self._gone(
                lambda: (
                    f"field '{self.path}': there is no '{key}'; {meant(key, names, known)}"
                )
            )
        place = names.index(key) if isinstance(key, str) else key
        if not isinstance(items, list | np.ndarray) or place >= len(items):
            raise self._gone(
                lambda: (
                    f"the list in field '{self.path}' is shorter; indices start at 0"
                )
            )
        if key == place and place < len(names):
            self._at.setdefault(place, {})[names[place]] = None
        return items[place]

    def _yaw(self, q: Any) -> float:
        try:
            norm = math.sqrt(q.w**2 + q.x**2 + q.y**2 + q.z**2)
        except (AttributeError, TypeError, OverflowError):
            norm = math.nan
        if not abs(norm - 1.0) < UNIT_NORM:
            raise self._gone(
                lambda: f"the quaternion in field '{self.path}' has norm {norm:.3g}",
                is_mistake=False,
            )
        sine = 2.0 * (q.w * q.z + q.x * q.y)
        cosine = norm**2 - 2.0 * (q.y**2 + q.z**2)
        return math.atan2(sine, cosine)


def items_of(message: Any) -> list[tuple[str, Any]]:
    """Return names and values of the content of a message."""
    if dataclasses.is_dataclass(message):
        return [(f.name, getattr(message, f.name)) for f in dataclasses.fields(message)]
    return list(getattr(message, "__dict__", {}).items())


def names_of(holder: Any, items: Any) -> list[str]:
    """Return the names of a list's elements: their own, or those in a list next to it."""
    if isinstance(items, list) and items:
        for own in _OWN_NAMES:
            names = [getattr(item, own, None) for item in items]
            if all(isinstance(name, str) for name in names):
                return [str(name) for name in names]
    for _, other in items_of(holder):
        is_list = isinstance(other, list) and len(other) > 0
        if is_list and all(isinstance(name, str) for name in other):
            return list(other)
    return []


def _fields(message: Any, prefix: str = "") -> list[str]:
    """Return the paths of the numbers in a message."""
    found = []
    for name, value in items_of(message):
        if items_of(value):
            found += _fields(value, f"{prefix}{name}.")
        elif not name.startswith("__"):
            found.append(f"{prefix}{name}")
    return found

"""A hall from a YAML file: for the range finders and for contacts of the mechatronic model."""

import math
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray

from hilserver.plant.errors import PlantError
from hilserver.plant.hall import Solid, default_hall, default_solids, wall_solids
from hilserver.signals.numbers import is_finite_number
from hilserver.small_file import read_small

MOST_WALLS: Final = 4096
MOST_SOLIDS: Final = 256
SLAB_M: Final = 0.05  # thickness of a slope

_KEYS: Final = ("walls", "height_m", "thickness_m", "slopes", "thresholds", "boxes")


class Hall(NamedTuple):
    """A hall for both models."""

    # shape (4 n,); x1, y1, x2, y2 [m] of each wall and of each side of a box, for the range
    # finders
    walls: NDArray[np.float64]
    solids: tuple[Solid, ...]  # floor and obstacles of the mechatronic model


def load_hall(hall: str, base_dir: Path) -> Hall:
    """Return ``default``, or the hall of a YAML file, whose path is relative to `base_dir`.

    PlantError if the file is missing or invalid.
    """
    if hall == "default":
        return Hall(default_hall(), default_solids())
    path = base_dir / hall
    where = f"sensors.tof.hall: {path}"
    try:
        content = yaml.safe_load(read_small(path).decode("utf-8"))
    except OSError as error:
        raise PlantError(f"{where} cannot be read: {error.strerror}.") from error
    except Exception as error:  # a wrong tag makes YAML's reader raise any exception
        reason = (str(error).splitlines() or ["it is not YAML"])[0]
        raise PlantError(f"{where} cannot be read: {reason}.") from error
    walls = content.get("walls") if isinstance(content, dict) else None
    if not isinstance(walls, list) or len(walls) > MOST_WALLS:
        raise PlantError(
            f"{where} must have a list `walls` of at most {MOST_WALLS} segments."
        )
    for number, wall in enumerate(walls, start=1):
        if not _are_numbers(wall, 4):
            raise PlantError(
                f"{where}: wall {number} must be four finite numbers [x1, y1, x2, y2] in m."
            )
    segments = np.array(walls, dtype=np.float64).reshape(-1)
    return _with_solids(where, content, segments)


def _are_numbers(value: object, length: int) -> bool:
    return (
        isinstance(value, list)
        and len(value) == length
        and all(map(is_finite_number, value))
    )


def _with_solids(
    where: str, content: dict[str, Any], walls: NDArray[np.float64]
) -> Hall:
    for key in content:
        if key not in _KEYS:
            raise PlantError(
                f"{where}: '{key}' is not a key of a hall; the keys are {', '.join(_KEYS)}."
            )
    sizes = [content.get("height_m", 1.0), content.get("thickness_m", 0.05)]
    if not _are_numbers(sizes, 2) or min(sizes) <= 0.0:
        raise PlantError(f"{where}: height_m and thickness_m must be numbers above 0.")
    solids = list(wall_solids(walls, *sizes))
    outlines = [walls]
    for kind, keys, make in (
        ("slopes", ("from", "to", "width_m", "rise_m"), _slope),
        ("thresholds", ("from", "to", "width_m", "height_m"), _threshold),
        ("boxes", ("centre", "size", "yaw_rad"), _box),
    ):
        entries = content.get(kind) or []
        if not isinstance(entries, list) or len(entries) > MOST_SOLIDS:
            raise PlantError(
                f"{where}: {kind} must be a list of at most {MOST_SOLIDS}."
            )
        for number, entry in enumerate(entries, start=1):
            try:
                if set(entry) - set(keys):
                    raise KeyError
                solid = make(entry)
            except (KeyError, TypeError, ValueError, OverflowError):
                raise PlantError(
                    f"{where}: {kind}, number {number}: must be {{{', '.join(keys)}}}, in m."
                ) from None
            solids.append(solid)
            if kind == "boxes":
                # The four sides of a box as wall segments
                c = math.cos(solid.yaw_rad)
                s = math.sin(solid.yaw_rad)
                (x, y, _), (a, b, _) = solid.centre_m, solid.half_m
                signs = ((a, b), (-a, b), (-a, -b), (a, -b))
                corners = [(x + c * u - s * v, y + s * u + c * v) for u, v in signs]
                sides = [
                    (*corner, *corners[(i + 1) % 4]) for i, corner in enumerate(corners)
                ]
                outline = np.array(sides).reshape(-1)
                outlines.append(outline)
    return Hall(np.concatenate(outlines), tuple(solids))


def _point(entry: dict[str, Any], key: str, length: int = 2) -> list[float]:
    value: list[float] = entry[key]
    if not _are_numbers(value, length):
        raise ValueError
    return value


def _size(entry: dict[str, Any], key: str) -> float:
    value = entry[key]
    if not _are_numbers([value], 1) or value <= 0.0:
        raise ValueError
    return float(value)


def _slope(entry: dict[str, Any]) -> Solid:
    """Return a slab whose upper side rises from the floor at `from` to `rise_m` at `to`."""
    (x1, y1), (x2, y2) = _point(entry, "from"), _point(entry, "to")
    run = math.hypot(x2 - x1, y2 - y1)
    rise = _size(entry, "rise_m")
    width = _size(entry, "width_m")
    pitch = math.atan2(rise, run)
    yaw = math.atan2(y2 - y1, x2 - x1)
    below = 0.5 * SLAB_M * math.sin(pitch)
    deep = 0.5 * SLAB_M * math.cos(pitch)
    x = 0.5 * (x1 + x2) + below * math.cos(yaw)
    y = 0.5 * (y1 + y2) + below * math.sin(yaw)
    z = 0.5 * rise - deep
    centre = (x, y, z)
    half = (0.5 * math.hypot(run, rise), 0.5 * width, 0.5 * SLAB_M)
    return Solid(centre, half, yaw, pitch, carries=True)


def _threshold(entry: dict[str, Any]) -> Solid:
    (x1, y1), (x2, y2) = _point(entry, "from"), _point(entry, "to")
    height = _size(entry, "height_m")
    width = _size(entry, "width_m")
    length = math.hypot(x2 - x1, y2 - y1)
    half = (0.5 * length, 0.5 * width, 0.5 * height)
    centre = (0.5 * (x1 + x2), 0.5 * (y1 + y2), 0.5 * height)
    yaw = math.atan2(y2 - y1, x2 - x1)
    return Solid(centre, half, yaw, carries=True)


def _box(entry: dict[str, Any]) -> Solid:
    (x, y), (length, width, height) = _point(entry, "centre"), _point(entry, "size", 3)
    if min(length, width, height) <= 0.0:
        raise ValueError
    (yaw,) = _point({"yaw": [entry.get("yaw_rad", 0.0)]}, "yaw", 1)
    half = (0.5 * length, 0.5 * width, 0.5 * height)
    centre = (float(x), float(y), 0.5 * height)
    return Solid(centre, half, float(yaw))

"""Which signals a measured log may hold, and which units fit them."""

import math
import re
from functools import cache
from typing import Final

from hilserver.measured.channels import (
    FIX_LATITUDE,
    FIX_LONGITUDE,
    FIX_STATUS,
    FIX_VARIANCE,
    ODOM_ANGULAR,
    ODOM_LINEAR,
)
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.units import RAD_S_PER_RPM
from hilserver.signals import (
    MEASURED,
    Direction,
    Ranges,
    Signal,
    SignalTable,
    robot_table,
)

ONLY_MAPPED_UNITS: Final = {
    ODOM_LINEAR: "m/s",
    ODOM_ANGULAR: "rad/s",
    FIX_LATITUDE: "deg",
    FIX_LONGITUDE: "deg",
    FIX_VARIANCE: "m²",
    FIX_STATUS: "1",
}
"""By channel that is no signal: signals are made of them, see `odometry` and `fixes`."""
_OF_THE_DAEMON = ("sim.", "internal.")


@cache
def _table() -> SignalTable:
    ranges = RobotParameters().ranges  # names and units are those of every robot
    return robot_table(Ranges(*ranges), body=True, observer=True)


@cache
def known_signals() -> dict[str, Signal]:
    """Return every signal that can be measured or commanded, by its name in the signal table."""
    found: dict[str, Signal] = {}
    for signal in _table():
        is_ours = signal.name.startswith(_OF_THE_DAEMON)
        if not (signal.is_array or signal.is_measured or is_ours):
            found[signal.name] = signal
    return found


def mapped_units() -> dict[str, str]:
    """Return the unit of everything that a mapping may name, by its name."""
    units = {name: signal.unit for name, signal in known_signals().items()}
    return units | ONLY_MAPPED_UNITS


def signal_unit(name: str) -> str:
    """Return the symbol of a signal's unit; 1 if there is no such signal."""
    signal = known_signals().get(name)
    return "1" if signal is None else signal.unit


@cache
def known_columns() -> tuple[str, ...]:
    """Return the columns that a log with our own names may have, besides time and segment."""
    return tuple(signal.name for signal in _table().scalars)


def is_input(name: str) -> bool:
    """Return whether a signal is commanded, not measured."""
    name = name.removeprefix(MEASURED)
    return name in _table() and _table()[name].direction is Direction.IN


_DIMENSIONS: dict[str, dict[str, float]] = {
    "angular speed": {
        "rad/s": 1.0,
        "deg/s": math.pi / 180.0,
        "rpm": RAD_S_PER_RPM,
        "rev/s": 2.0 * math.pi,
    },
    "angle": {"rad": 1.0, "deg": math.pi / 180.0, "rev": 2.0 * math.pi},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "speed": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1.0 / 3.6},
    "acceleration": {"m/s²": 1.0, "m/s2": 1.0, "g": 9.80665},
    "voltage": {"V": 1.0, "mV": 1e-3},
    "share": {"%": 1e-2, "1": 1.0},
}


def units_of(unit: str) -> tuple[str, ...]:
    """Return the units that measure the same quantity as `unit`."""
    return next((tuple(d) for d in _DIMENSIONS.values() if unit in d), (unit,))


def conversion(unit: str, wanted: str) -> float | None:
    """Return the factor from `unit` to `wanted`, None if they measure different quantities."""
    if unit == wanted:
        return 1.0
    for factors in _DIMENSIONS.values():
        if unit in factors and wanted in factors:
            return factors[unit] / factors[wanted]
    return None


_SPELT: Final = {
    "1/min": "rpm",
    "u/min": "rpm",
    "r/min": "rpm",
    "min^-1": "rpm",
    "rad s^-1": "rad/s",
    "rad/sec": "rad/s",
    "°/s": "deg/s",
    "dps": "deg/s",
    "deg/sec": "deg/s",
    "degrees": "deg",
    "°": "deg",
    "radians": "rad",
    "m s^-1": "m/s",
    "mps": "m/s",
    "kmh": "km/h",
    "m s^-2": "m/s2",
    "m/s^2": "m/s2",
    "meters": "m",
    "metres": "m",
    "volt": "V",
    "volts": "V",
    "percent": "%",
}
"""Other spellings of units, in lower case."""
_IN_NAMES: Final = (
    (r"rad(ps|s|_?p?er_?s|_s)(ec)?(?![a-z])", "rad/s"),
    (r"deg(ps|s|_s|_per_s)(?![a-z])|(?<![a-z])dps(?![a-z])", "deg/s"),
    (r"rpm", "rpm"),
    (r"(?<![a-z])m_?p?s(?![a-z])", "m/s"),
    (r"(?<![a-z])rad(?![a-z])", "rad"),
    (r"(?<![a-z])deg(?![a-z])", "deg"),
    (r"(?<![a-z])(cm|mm|mv)(?![a-z])", ""),
)


def unit_in_text(text: str, wanted: str) -> str | None:
    """Return the unit that stands in a row of units, if it measures what `wanted` does."""
    lower = text.strip().lower()
    known = {unit.lower(): unit for unit in units_of(wanted)}
    unit = _SPELT.get(lower) or known.get(lower)
    return unit if unit is not None and conversion(unit, wanted) is not None else None


def is_other_unit(text: str, wanted: str) -> bool:
    """Return whether a text is a unit, but none that measures what `wanted` does."""
    lower = text.strip().lower()
    known = {unit.lower() for units in _DIMENSIONS.values() for unit in units} - {"1"}
    return (lower in known or lower in _SPELT) and unit_in_text(text, wanted) is None


def in_brackets(name: str) -> list[str]:
    """Return what stands in brackets in a name."""
    return re.findall(r"[\[(]([^\])]+)[\])]", name)


def unit_in_name(name: str, wanted: str) -> str | None:
    """Return the unit in the name of a column, if it measures what `wanted` does."""
    for bracketed in in_brackets(name):
        if (unit := unit_in_text(bracketed, wanted)) is not None:
            return unit
    for pattern, unit in _IN_NAMES:
        found = re.search(pattern, name.lower())
        named = unit or (found[0].replace("mv", "mV") if found else "")
        if found and conversion(named, wanted) is not None:
            return named
    return None

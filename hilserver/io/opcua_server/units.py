"""Units of measurement: our symbols and their codes in OPC UA.

OPC UA names units by the UNECE codes of recommendation 20. `unit_id` is the number that OPC 10000-8
makes of a code: its ASCII characters as the bytes of a big-endian integer ("MTR" is 0x4D5452).
"""

from dataclasses import dataclass

from hilserver.errors import ConfigError

NAMESPACE_URI = "http://www.opcfoundation.org/UA/units/un/cefact"
"""NamespaceUri of every EUInformation with a UNECE code."""


@dataclass(frozen=True, slots=True)
class Unit:
    """One unit."""

    symbol: str  # as the signal table and the display write it
    code: str  # UNECE common code, two or three characters
    unit_id: int  # the code as OPC UA's EUInformation.UnitId
    description: str  # UNECE name


def unit_id(code: str) -> int:
    """Return OPC UA's number for a UNECE common code (OPC 10000-8, EUInformation)."""
    return int.from_bytes(code.encode("ascii"), "big")


_ROWS = (
    ("1", "C62", "one"),
    ("%", "P1", "percent"),
    ("rpm", "RPM", "revolutions per minute"),
    ("rad", "C81", "radian"),
    ("deg", "DD", "degree [unit of angle]"),
    ("rad/s", "2A", "radian per second"),
    ("deg/s", "E96", "degree per second"),
    ("rad/s²", "2B", "radian per second squared"),
    ("m", "MTR", "metre"),
    ("m²", "MTK", "square metre"),
    ("mm", "MMT", "millimetre"),
    ("cm", "CMT", "centimetre"),
    ("m/s", "MTS", "metre per second"),
    ("mm/s", "C16", "millimetre per second"),
    ("km/h", "KMH", "kilometre per hour"),
    ("m/s²", "MSK", "metre per second squared"),
    ("s", "SEC", "second [unit of time]"),
    ("ms", "C26", "millisecond"),
    ("us", "B98", "microsecond"),
    ("ns", "C47", "nanosecond"),
    ("min", "MIN", "minute [unit of time]"),
    ("h", "HUR", "hour"),
    ("Hz", "HTZ", "hertz"),
    ("V", "VLT", "volt"),
    ("mV", "2Z", "millivolt"),
    ("A", "AMP", "ampere"),
    ("mA", "4K", "milliampere"),
    ("Ah", "AMH", "ampere hour"),
    ("ohm", "OHM", "ohm"),
    ("W", "WTT", "watt"),
    ("J", "JOU", "joule"),
    ("N", "NEW", "newton"),
    ("N·m", "NU", "newton metre"),
    ("kg", "KGM", "kilogram"),
    ("kg·m²", "B32", "kilogram metre squared"),
    ("°C", "CEL", "degree Celsius"),
    ("K", "KEL", "kelvin"),
    ("Pa", "PAL", "pascal"),
)

UNECE: dict[str, Unit] = {
    symbol: Unit(symbol, code, unit_id(code), description)
    for symbol, code, description in _ROWS
}
"""Every unit that a signal may have, by symbol; "1" is no unit."""


def find_unit(symbol: str) -> Unit:
    """Return the unit of that symbol.

    ConfigError if there is none; its sentence lists the known ones.
    """
    if symbol not in UNECE:
        raise ConfigError(
            f"unit '{symbol}' is unknown; write one of {', '.join(UNECE)}"
        )
    return UNECE[symbol]

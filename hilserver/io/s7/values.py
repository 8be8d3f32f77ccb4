"""Numbers in a data block: big-endian, in the types of a controller."""

import math
import struct
from collections.abc import Mapping
from typing import Final

from hilserver.config.s7 import FORMS, Place
from hilserver.errors import ConfigError
from hilserver.signals import Signal, ValueType

_LARGEST_REAL: Final = struct.unpack(">f", b"\x7f\x7f\xff\xff")[0]
_PACKERS: Final[Mapping[str, struct.Struct]] = {
    name: struct.Struct(">" + form.code) for name, form in FORMS.items()
}
COUNTING: Final = frozenset((ValueType.INT64, ValueType.UINT32))
"""Types of signals that wrap where the controller's type is shorter; others stop at its limit."""


def packed(place: Place, value: float, *, wraps: bool = False) -> bytes:
    """Return a value in the type of its place; the nearest that this type has.

    Parameters
    ----------
    wraps : bool
        Whether a whole number that is too large begins anew.
    """
    packer = _PACKERS[place.type]
    if place.type == "BOOL":
        return packer.pack(bool(value))
    if place.type == "REAL":
        limit = _LARGEST_REAL
        return packer.pack(max(-limit, min(limit, value)) if math.isfinite(value) else value)
    if place.type == "LREAL":
        return packer.pack(value)
    if not math.isfinite(value):
        return bytes(place.size)
    bits, whole = 8 * place.size, round(value)
    signed = FORMS[place.type].code.islower()
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    if wraps:
        whole = (whole - low) % (1 << bits) + low
    return packer.pack(max(low, min(high, whole)))


def unpacked(place: Place, data: bytes, start: int = 0) -> bool | int | float:
    """Return the value of a place.

    Parameters
    ----------
    start : int
        Byte of the block at which `data` begin.
    """
    if place.type == "BOOL":
        return bool(data[place.byte - start] >> place.bit & 1)
    value: int | float = _PACKERS[place.type].unpack_from(data, place.byte - start)[0]
    return value


def put(block: bytearray, place: Place, data: bytes, start: int = 0) -> None:
    """Put what `packed` returned into a block; other bits of its byte stay."""
    at = place.byte - start
    if place.type == "BOOL":
        block[at] = block[at] & ~(1 << place.bit) | data[0] << place.bit
    else:
        block[at : at + len(data)] = data


def check_type(signal: Signal, kind: str) -> None:
    """Refuse a type that a signal cannot have.

    Raises
    ------
    ConfigError
        In words.
    """
    if (kind == "BOOL") != (signal.type is ValueType.BOOLEAN):
        have = "BOOL" if signal.type is ValueType.BOOLEAN else "a number, as REAL"
        raise ConfigError(f"'{signal.name}' is {have}, not {kind}")

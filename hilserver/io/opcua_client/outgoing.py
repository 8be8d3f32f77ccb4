"""Our outputs in the form that a peer's nodes accept: type, with or without stamp and status."""

import math
from datetime import datetime
from enum import IntEnum
from typing import Final

from asyncua import ua

_FLOATS: Final = {
    ua.VariantType.Double: math.inf,
    ua.VariantType.Float: 3.4028235677973366e38,  # from here on a value rounds to infinity
}
_INTEGERS: Final = {
    ua.VariantType.SByte: (-(2**7), 2**7 - 1),
    ua.VariantType.Byte: (0, 2**8 - 1),
    ua.VariantType.Int16: (-(2**15), 2**15 - 1),
    ua.VariantType.UInt16: (0, 2**16 - 1),
    ua.VariantType.Int32: (-(2**31), 2**31 - 1),
    ua.VariantType.UInt32: (0, 2**32 - 1),
    ua.VariantType.Int64: (-(2**63), 2**63 - 1),
    ua.VariantType.UInt64: (0, 2**64 - 1),
}
_ABSTRACT: Final = {
    24: ua.VariantType.Double,  # BaseDataType
    26: ua.VariantType.Double,  # Number
    27: ua.VariantType.Int64,  # Integer
    28: ua.VariantType.UInt64,  # UInteger
    29: ua.VariantType.Int32,  # Enumeration
    290: ua.VariantType.Double,  # Duration
}
_BUILT_IN: Final = {
    kind.value: kind for kind in (*_FLOATS, *_INTEGERS, ua.VariantType.Boolean)
} | _ABSTRACT


class SentForm(IntEnum):
    """What is sent with a value; a server may refuse status and stamp (Part 4, 5.11.4)."""

    WHOLE = 0
    STAMPED = 1
    STATUS = 2
    BARE = 3

    @property
    def has_status(self) -> bool:
        """Whether the status is sent."""
        return self in (SentForm.WHOLE, SentForm.STATUS)

    @property
    def has_stamp(self) -> bool:
        """Whether the source time stamp is sent."""
        return self in (SentForm.WHOLE, SentForm.STAMPED)


class UnfitError(ValueError):
    """A value that the type of the node cannot hold; the message says why."""


def variant_type(data_type: ua.NodeId) -> ua.VariantType | None:
    """Return the built-in type for a DataType node; None if it is not numeric."""
    if data_type.NamespaceIndex != 0 or not isinstance(data_type.Identifier, int):
        return None
    return _BUILT_IN.get(data_type.Identifier)


def variant(value: object, kind: ua.VariantType, *, is_bad: bool = False) -> ua.Variant:
    """Return `value` (number, bool or list of them) in the type of the peer's node.

    `is_bad`: its status marks it as unusable, so that a floating-point number need not be finite.
    UnfitError if the type cannot hold it.
    """
    fit = _float if kind in _FLOATS else _whole
    if isinstance(value, list | tuple):
        return ua.Variant([fit(part, kind, is_bad) for part in value], kind)
    return ua.Variant(fit(value, kind, is_bad), kind)


def _float(value: object, kind: ua.VariantType, is_bad: bool) -> float:
    if not isinstance(value, int | float) or not (is_bad or math.isfinite(value)):
        raise UnfitError(f"{value!s:.40} is not a finite number")
    if math.isfinite(value) and abs(value) >= _FLOATS[kind]:
        raise UnfitError(f"{value:g} does not fit into {kind.name}")
    return float(value)


def _whole(value: object, kind: ua.VariantType, _is_bad: bool) -> bool | int:
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise UnfitError(f"{value!s:.40} does not fit into {kind.name}")
    if kind is ua.VariantType.Boolean:
        return bool(value)
    (low, high), whole = _INTEGERS[kind], round(value)
    if not low <= whole <= high:
        raise UnfitError(f"{value:g} does not fit into {kind.name} ({low} to {high})")
    return whole


def data_value(
    value: ua.Variant, form: SentForm, status: int, stamp: datetime
) -> ua.DataValue:
    """Return the value to send; without this the library would fill in a missing status."""
    code = ua.StatusCode(ua.UInt32(status)) if form.has_status else None
    source_stamp = stamp if form.has_stamp else None
    return ua.DataValue(
        value,
        StatusCode=code,
        SourceTimestamp=source_stamp,
    )

"""Bounds for asyncua's decoder: an array cannot have more elements than its message has bytes.

What one operation of a request carries in lists has a bound of its own: a Variant, decoded, costs a
hundred times what it costs to send. Lists of numbers are cheap and go by their bytes.

An enumeration keeps a number that names nothing: whoever asks for it decides which status code that
deserves, instead of the whole message failing.

Without them a message of a hundred bytes whose array of Null announces 2^31 elements fills the
memory, and the request header is decoded before anybody has logged in.
"""

import functools
import math
from collections.abc import Callable
from enum import IntFlag
from typing import Any, TypeVar

from asyncua import ua
from asyncua.common.utils import NotEnoughData, ServiceError
from asyncua.ua import ua_binary

MAX_MATRIX_ELEMENTS = 10_000
MAX_DECODED = 2000  # in the lists of one operation, numbers apart
_LENGTH_BYTES = 4
_Type = ua.VariantType
T = TypeVar("T")
_NUMBERS = [kind for kind in _Type if 1 <= kind.value <= 11]  # Boolean to Double
_WEIGHTS: dict[Any, int] = {
    **dict.fromkeys(_NUMBERS, 0),
    **dict.fromkeys((_Type.ExtensionObject, _Type.DataValue, _Type.DiagnosticInfo), 4),
}
"""What an element counts; those that hold others are the dearest, with some 50 us each."""
_left = [math.inf]


def within_bounds(decode: Callable[[], T]) -> T:
    """Decode something that a client of ours has sent; what our own peers send has no bound.

    ServiceError: BadEncodingLimitsExceeded, or BadDecodingError whatever else is wrong.
    """
    _left[0] = MAX_DECODED
    try:
        return decode()
    except ServiceError:
        raise
    except Exception:  # noqa: BLE001 - whatever a decoder of others trips over is the sender's
        raise ServiceError(ua.StatusCodes.BadDecodingError) from None
    finally:
        _left[0] = math.inf


def bound_decoder() -> None:
    """Put the bounds into asyncua's decoder; once for the process, again is harmless."""
    ua_binary.MAX_RESHAPE_ELEMENTS = MAX_MATRIX_ELEMENTS
    for name in ("_create_uatype_array_deserializer", "_create_list_deserializer"):
        create = getattr(ua_binary, name)
        if not hasattr(create, "is_bounded"):
            setattr(ua_binary, name, _bounded(create))
            for cached in vars(ua_binary).values():
                if hasattr(cached, "cache_clear"):
                    cached.cache_clear()
    if not hasattr(ua_binary.create_enum_deserializer, "is_lenient"):
        ua_binary.create_enum_deserializer = _lenient(ua_binary.create_enum_deserializer)


def _lenient(create: Callable[[Any], Callable[[Any], Any]]) -> Callable[[Any], Any]:
    def create_lenient(kind: Any) -> Callable[[Any], Any]:
        if issubclass(kind, IntFlag):
            return create(kind)
        members = {int(member): member for member in kind}

        def decode(data: Any) -> Any:
            number = int.from_bytes(data.read(4), "little", signed=True)
            return members.get(number, number)

        return decode

    create_lenient.is_lenient = True  # type: ignore[attr-defined]
    return create_lenient


def _bounded(create: Callable[[Any], Callable[[Any], Any]]) -> Callable[[Any], Any]:
    @functools.cache
    def create_bounded(element_type: Any) -> Callable[[Any], Any]:
        decode = create(element_type)
        weight = _WEIGHTS.get(element_type, 1)

        def decode_bounded(data: Any) -> Any:
            rest = data.copy() if isinstance(data, ua.utils.Buffer) else None
            if rest is not None and len(rest) >= _LENGTH_BYTES:
                announced = int.from_bytes(rest.read(_LENGTH_BYTES), "little", signed=True)
                if announced > len(rest):
                    raise NotEnoughData(f"{announced} elements announced, {len(rest)} bytes left")
                _left[0] -= weight * max(announced, 0)
                if _left[0] < 0:
                    raise ServiceError(ua.StatusCodes.BadEncodingLimitsExceeded)
            return decode(data)

        return decode_bounded

    create_bounded.is_bounded = True  # type: ignore[attr-defined]
    return create_bounded

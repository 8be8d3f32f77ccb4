"""Bounds for asyncua's decoder: an array cannot have more elements than its message has bytes.

Lists in one operation of a request have a bound of their own: to decode a Variant costs a hundred
times more than to send it. Lists of numbers are cheap and only bounded by their bytes.

An enumeration may hold an undefined number: the service decides which status code that deserves,
instead of the whole message failing.

Without these bounds a message of a hundred bytes whose array of Null announces 2^31 elements would
fill the memory, and the request header is decoded before any log-in.
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
MAX_DECODED = 2000  # elements in the lists of one operation, except numbers
_LENGTH_BYTES = 4
_Type = ua.VariantType
T = TypeVar("T")
_NUMBERS = [kind for kind in _Type if 1 <= kind.value <= 11]  # Boolean to Double
_WEIGHTS: dict[Any, int] = {
    **dict.fromkeys(_NUMBERS, 0),
    **dict.fromkeys((_Type.ExtensionObject, _Type.DataValue, _Type.DiagnosticInfo), 4),
}
"""Weight of an element; those that hold others are the most expensive, about 50 us each."""
_left = [math.inf]


def within_bounds(decode: Callable[[], T]) -> T:
    """Decode data from a client of our server; data from our own peers has no bound.

    ServiceError: BadEncodingLimitsExceeded, or BadDecodingError for any other error.
    """
    _left[0] = MAX_DECODED
    try:
        return decode()
    except ServiceError:
        raise
    except Exception:  # noqa: BLE001 - whatever the decoder trips over is an error of the sender
        raise ServiceError(ua.StatusCodes.BadDecodingError) from None
    finally:
        _left[0] = math.inf


def bound_decoder() -> None:
    """Put the bounds into asyncua's decoder, once per process; repeating it is harmless."""
    ua_binary.MAX_RESHAPE_ELEMENTS = MAX_MATRIX_ELEMENTS
    for name in ("_create_uatype_array_deserializer", "_create_list_deserializer"):
        create = getattr(ua_binary, name)
        if not hasattr(create, "is_bounded"):
            setattr(ua_binary, name, _bounded(create))
            for cached in vars(ua_binary).values():
                if hasattr(cached, "cache_clear"):
                    cached.cache_clear()
    if not hasattr(ua_binary.create_enum_deserializer, "is_lenient"):
        ua_binary.create_enum_deserializer = _lenient(
            ua_binary.create_enum_deserializer
        )


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
                announced = int.from_bytes(
                    rest.read(_LENGTH_BYTES), "little", signed=True
                )
                if announced > len(rest):
                    raise NotEnoughData(
                        f"{announced} elements announced, {len(rest)} bytes left"
                    )
                _left[0] -= weight * max(announced, 0)
                if _left[0] < 0:
                    raise ServiceError(ua.StatusCodes.BadEncodingLimitsExceeded)
            return decode(data)

        return decode_bounded

    create_bounded.is_bounded = True  # type: ignore[attr-defined]
    return create_bounded

"""Bounds for asyncua's decoder: an array cannot have more elements than its message has bytes.

Without them a message of a hundred bytes whose array of Null announces 2^31 elements fills the
memory, and the request header is decoded before anybody has logged in.
"""

import functools
from collections.abc import Callable
from typing import Any

from asyncua import ua
from asyncua.common.utils import NotEnoughData
from asyncua.ua import ua_binary

MAX_MATRIX_ELEMENTS = 10_000
_LENGTH_BYTES = 4


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


def _bounded(create: Callable[[Any], Callable[[Any], Any]]) -> Callable[[Any], Any]:
    @functools.cache
    def create_bounded(element_type: Any) -> Callable[[Any], Any]:
        decode = create(element_type)

        def decode_bounded(data: Any) -> Any:
            rest = data.copy() if isinstance(data, ua.utils.Buffer) else None
            if rest is not None and len(rest) >= _LENGTH_BYTES:
                announced = int.from_bytes(rest.read(_LENGTH_BYTES), "little", signed=True)
                if announced > len(rest):
                    raise NotEnoughData(f"{announced} elements announced, {len(rest)} bytes left")
            return decode(data)

        return decode_bounded

    create_bounded.is_bounded = True  # type: ignore[attr-defined]
    return create_bounded

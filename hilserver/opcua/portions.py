"""Requests in portions: decoded, done and encoded one operation after the other, within bounds.

A request may have a thousand operations, and their number does not tell how long they take. Between
any two the event loop may do other work, and once a request has used up its time, its remaining
operations are answered BadTimeout.
"""

import functools
import inspect
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any, get_args, get_origin

from asyncua import ua
from asyncua.common.utils import Buffer, ServiceError
from asyncua.ua.ua_binary import (
    create_type_serializer,
    from_binary,
    get_safe_type_hints,
    to_binary,
)

from hilserver.opcua.decoding import within_bounds
from hilserver.opcua.rotation import Portions

_Codes = ua.StatusCodes
_COUNT_BYTES = 4


def decoded(kind: type, body: Buffer, most: int) -> Portions:
    """Decode the parameters of a service, whose last field is the list of its operations.

    ServiceError: BadTooManyOperations, or BadDecodingError for any other error.
    """
    *first, (name, element) = _layout(kind)
    values: dict[str, Any] = {n: take(t, body) for n, t in first}
    if get_origin(element) is not list:
        return kind(**values, **{name: take(element, body)})
    (element,) = get_args(element)
    count = take(ua.Int32, body)
    if count > most:
        raise ServiceError(_Codes.BadTooManyOperations)
    operations = values[name] = []
    for _ in range(count):
        operations.append(take(element, body))
        yield
    return kind(**values)


def take(kind: Any, body: Buffer) -> Any:
    """Decode one structure; BadDecodingError for any error."""
    return within_bounds(lambda: from_binary(kind, body))


@functools.cache
def _layout(kind: Any) -> list[tuple[str, Any]]:
    hints = get_safe_type_hints(kind, {"ua": ua})
    return [(field.name, hints[field.name]) for field in fields(kind)]


def each(
    session: Any,
    operations: Sequence[Any] | None,
    act: Callable[[Any], Any],
    response: Any,
    kind: type = ua.StatusCode,
) -> Portions:
    """Return the response with the results of all operations.

    Parameters
    ----------
    act : callable
        Does one operation, maybe in portions, and returns its result, or None if that is a status
        code; a ServiceError is the result of this operation alone.
    response : UA structure
        Gets the results.
    kind : type
        Of a result.
    """
    results: list[Any] = []
    for operation in limited(session, operations):
        try:
            if session.is_out_of_time:
                raise ServiceError(_Codes.BadTimeout)
            result = act(operation)
            if inspect.isgenerator(result):
                result = yield from result
            results.append(ua.StatusCode(_Codes.Good) if result is None else result)
        except ServiceError as error:
            code = ua.StatusCode(error.code)
            results.append(code if kind is ua.StatusCode else kind(StatusCode=code))
        yield
    getattr(response, "Parameters", response).Results = results
    return response


def encoded(message: Any) -> Portions:
    """Encode a response."""
    parts: list[bytes] = []
    yield from _encode(message, parts)
    return b"".join(parts)


def _encode(message: Any, parts: list[bytes]) -> Portions:
    for name, kind in _layout(message.__class__):
        value = getattr(message, name)
        if get_origin(kind) is list and value:
            (element,) = get_args(kind)
            parts.append(len(value).to_bytes(_COUNT_BYTES, "little"))
            # Elements of these types may be long themselves.
            has_list = element in (ua.BrowseResult, ua.BrowsePathResult)
            if has_list:
                for item in value:
                    yield from _encode(item, parts)
            else:
                pack = create_type_serializer(element)
                for item in value:
                    parts.append(pack(item))
                    yield
        elif name == "Parameters":
            yield from _encode(value, parts)
        else:
            parts.append(to_binary(kind, value))


# --- common to the services -----------------------------------------------------------------------


def limited(session: Any, items: Sequence[Any] | None) -> Sequence[Any]:
    """Return `items` if a request may have as many."""
    if not items:
        raise ServiceError(_Codes.BadNothingToDo)
    if len(items) > session.server.settings.max_operations:
        raise ServiceError(_Codes.BadTooManyOperations)
    return items


def status_codes(codes: Sequence[int]) -> list[ua.StatusCode]:
    """Return `codes` in the form in which they are sent."""
    return [ua.StatusCode(code) for code in codes]


def check_stamps(stamps: int) -> int:
    """Return `stamps` if it is valid (OPC 10000-4, TimestampsToReturn)."""
    if stamps in (0, 1, 2, 3):
        return int(stamps)
    raise ServiceError(_Codes.BadTimestampsToReturnInvalid)

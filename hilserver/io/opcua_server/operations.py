"""What the services share: bounds of a request, and a status code for each operation in it."""

from collections.abc import Sequence
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError

from hilserver.io.opcua_server.sessions import RobotSession

_Codes = ua.StatusCodes


def limited(session: RobotSession, items: Sequence[Any] | None) -> Sequence[Any]:
    """Return `items` if a request may have so many."""
    if not items:
        raise ServiceError(_Codes.BadNothingToDo)
    if len(items) > session.server.config.max_operations:
        raise ServiceError(_Codes.BadTooManyOperations)
    return items


def status_codes(codes: Sequence[int]) -> list[ua.StatusCode]:
    """Return `codes` as they are sent."""
    return [ua.StatusCode(code) for code in codes]


def check_stamps(stamps: int) -> int:
    """Return the time stamps to return if there are such (OPC 10000-4, TimestampsToReturn)."""
    if stamps in (0, 1, 2, 3):
        return int(stamps)
    raise ServiceError(_Codes.BadTimestampsToReturnInvalid)

"""Calls of methods: their arguments are checked, and every answer has its status code.

==================  ==========================================================================
BadArgumentsMissing  fewer arguments than described
BadTooManyArguments  more
BadInvalidArgument   another type (the argument's result says which), or a value out of range
BadInvalidState      not possible now; the diagnostic text says why
BadNotImplemented    Force, Unforce, InjectFault, ClearFaults of a server without faults
BadUserAccessDenied  the user's role does not allow it
==================  ==========================================================================
"""

import inspect
from collections.abc import Callable
from typing import Any, NamedTuple

from asyncua import ua
from asyncua.crypto.permission_rules import User

from hilserver.core.control import Control
from hilserver.errors import UserError
from hilserver.faults import Faults
from hilserver.io.opcua_server.access import Access
from hilserver.io.opcua_server.logs import log
from hilserver.io.opcua_server.method_table import METHODS, Files, Method, Parts
from hilserver.io.opcua_server.model import DATA_TYPES

_Codes = ua.StatusCodes


class CallAnswer(NamedTuple):
    """Result of one call: what goes to the client, and a sentence where it is refused."""

    result: ua.CallMethodResult
    text: str = ""


class Methods:
    """Checks the arguments of a call and does what it asks for.

    Parameters
    ----------
    control : Control
        The daemon's state machine.
    node_id : callable
        Node id of a dotted name.
    """

    def __init__(
        self,
        control: Control,
        access: Access,
        node_id: Callable[[str], ua.NodeId],
        faults: Faults | None = None,
        files: Files | None = None,
    ) -> None:
        self._access = access
        self._object = node_id("methods")
        self._by_id = {node_id(method.node_id): method for method in METHODS}
        self._parts = Parts(control, faults, files)

    def __contains__(self, method_id: object) -> bool:
        return method_id in self._by_id

    async def call(self, request: ua.CallMethodRequest, user: User) -> CallAnswer:
        """Answer one call of a method of ours."""
        method = self._by_id[request.MethodId]
        if request.ObjectId != self._object:
            return _refuse(_Codes.BadMethodInvalid, "the methods belong to the object s=methods")
        if not self._access.may_call(user, method.name):
            return _refuse(_Codes.BadUserAccessDenied, "your role does not allow this call")
        arguments = list(request.InputArguments or [])
        wrong = _check_arguments(method, arguments)
        if wrong is not None:
            return wrong
        answer = await self._run(method, [argument.Value for argument in arguments])
        log.info("opcua method", method=method.name, refused=answer.text or None)
        return answer

    async def _run(self, method: Method, values: list[Any]) -> CallAnswer:
        try:
            outcome = method.act(self._parts, *values)
            if inspect.isawaitable(outcome):
                await outcome
        except NotImplementedError as error:
            return _refuse(_Codes.BadNotImplemented, str(error))
        except UserError as error:
            return _refuse(_Codes.BadInvalidState, str(error))
        except ValueError as error:
            results = [ua.StatusCode(_Codes.BadOutOfRange) for _ in values]
            return _refuse(_Codes.BadInvalidArgument, str(error), results)
        except OSError as error:
            return _refuse(_Codes.BadResourceUnavailable, str(error))
        except Exception as error:  # noqa: BLE001 - a client must get an answer, and no traceback
            log.error("opcua method failed", method=method.name, error=repr(error))
            return _refuse(_Codes.BadInternalError, "internal error, see the log")
        return CallAnswer(ua.CallMethodResult(StatusCode=ua.StatusCode(_Codes.Good)))


def _refuse(code: int, text: str, results: list[ua.StatusCode] | None = None) -> CallAnswer:
    result = ua.CallMethodResult(StatusCode=ua.StatusCode(code), InputArgumentResults=results or [])
    return CallAnswer(result, text)


def _check_arguments(method: Method, arguments: list[ua.Variant]) -> CallAnswer | None:
    signature = ", ".join(f"{a.type} {a.name}" for a in method.arguments) or "no arguments"
    if len(arguments) < len(method.arguments):
        return _refuse(_Codes.BadArgumentsMissing, f"{method.name} takes {signature}")
    if len(arguments) > len(method.arguments):
        return _refuse(_Codes.BadTooManyArguments, f"{method.name} takes {signature}")
    results = [
        ua.StatusCode(_Codes.Good if _fits(argument.type, given) else _Codes.BadTypeMismatch)
        for argument, given in zip(method.arguments, arguments, strict=True)
    ]
    if any(result.value != _Codes.Good for result in results):
        return _refuse(_Codes.BadInvalidArgument, f"{method.name} takes {signature}", results)
    return None


def _fits(type_name: str, given: ua.Variant) -> bool:
    is_type = given.VariantType.value == DATA_TYPES[type_name]
    return is_type and not given.is_array and given.Value is not None

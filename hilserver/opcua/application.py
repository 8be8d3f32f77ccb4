"""What stands behind a server: answers Write and Call, and classifies clients.

`Application` serves the nodes made through asyncua's own interface. A program with other rules for
writing, or other effects, derives a class from it and assigns an instance to
`HardenedServer.application`.

====================  ==========================================================================
BadNotWritable        not an input, or another attribute than Value
BadUserAccessDenied   the user's role does not allow it
BadWriteNotSupported  with an index range or with a status code that is not Good
BadTypeMismatch       another data type, scalar for array
BadMethodInvalid      the method does not belong to that object
BadArgumentsMissing   fewer arguments than described
BadTooManyArguments   more
BadInvalidArgument    another type; the result of the argument shows which one
====================  ==========================================================================
"""

from collections.abc import Generator, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from asyncua import ua

from hilserver.opcua.access import Access
from hilserver.opcua.settings import Role

_Codes, _Attributes = ua.StatusCodes, ua.AttributeIds
_CAN_WRITE = ua.AccessLevel.CurrentWrite.mask
_INPUT_ARGUMENTS = ua.QualifiedName("InputArguments", 0)
_SCALAR = -1  # ValueRank of a scalar (OPC 10000-3, 5.6.2)
_BUILT_IN = {kind.value for kind in ua.VariantType} - {ua.VariantType.Variant.value}


class Answer(NamedTuple):
    """Result of one write: status code, and a sentence if it is refused."""

    code: int
    text: str = ""


class CallAnswer(NamedTuple):
    """Result of one call: the answer to the client, and a sentence if it is refused."""

    result: ua.CallMethodResult
    text: str = ""


ACCEPTED = Answer(_Codes.Good)


def refused(
    code: int, text: str = "", results: list[ua.StatusCode] | None = None
) -> CallAnswer:
    """Return the answer to a call that is refused."""
    result = ua.CallMethodResult(
        StatusCode=ua.StatusCode(code), InputArgumentResults=results or []
    )
    return CallAnswer(result, text)


@dataclass(frozen=True, slots=True)
class Visitor:
    """A client as the application classifies it, from the name that it gives its session."""

    address: str  # of its user, for failed log-ins; empty: only the user name counts
    has_own_place: bool = False  # it does not count for the places that clients share


class Application:
    """Serves variables that are writable and methods that have a function.

    Permissions name nodes by the text identifier of the node id, or else by the browse name.
    """

    def __init__(self, server: Any, access: Access) -> None:
        self._server = server
        self._space = server.aspace
        self._access = access

    def visitor(self, session_name: str, address: str) -> Visitor:  # noqa: ARG002 - for others
        """Return the visitor for a client that gives its session this name."""
        return Visitor(address)

    def left(self, session: Any) -> None:
        """Note that a session is over, or has lost its connection."""

    def has_reserve(self, user: Any) -> bool:
        """Whether places are reserved for a user, however many others there are."""
        return bool(user.rights > Role.OBSERVER)

    def name_of(self, node_id: ua.NodeId) -> str:
        """Return the name of a node in permissions."""
        if isinstance(node_id.Identifier, str):
            return node_id.Identifier
        node = self._space.get(node_id)
        place = None if node is None else node.attributes[_Attributes.BrowseName]
        if place is None:
            return ""
        return str(place.value.Value.Value.Name)

    def may_write(self, user: Any, node_id: ua.NodeId) -> bool:
        """Whether a user may write a variable."""
        return self._access.may_write(user, self.name_of(node_id))

    def may_call(self, user: Any, node_id: ua.NodeId) -> bool:
        """Whether a user may call a method."""
        return self._access.may_call(user, self.name_of(node_id))

    def refuse(self, item: ua.WriteValue, user: Any) -> Answer | None:
        """Return why a user cannot write this, None if that depends on the value."""
        node = self._space.get(item.NodeId)
        if node is None:
            return Answer(_Codes.BadNodeIdUnknown)
        if item.AttributeId not in node.attributes:
            return Answer(_Codes.BadAttributeIdInvalid)
        if item.AttributeId != _Attributes.Value or not self.is_writable(item.NodeId):
            return Answer(_Codes.BadNotWritable, "only inputs can be written")
        if not self.may_write(user, item.NodeId):
            return Answer(
                _Codes.BadUserAccessDenied, "your role does not allow this write"
            )
        if item.IndexRange:
            return Answer(_Codes.BadWriteNotSupported, "write the whole array")
        if (
            item.Value.StatusCode is not None
            and item.Value.StatusCode.value != _Codes.Good
        ):
            return Answer(
                _Codes.BadWriteNotSupported,
                "only values with status Good can be written",
            )
        return None

    def is_writable(self, node_id: ua.NodeId) -> bool:
        """Whether a variable is an input."""
        level = self._space[node_id].attributes.get(_Attributes.UserAccessLevel)
        return level is not None and bool(level.value.Value.Value & _CAN_WRITE)

    def write(
        self, items: Iterable[ua.WriteValue], session: Any
    ) -> Generator[Any, Any, list[Answer]]:
        """Return one answer per item; yields between them."""
        answers: list[Answer] = []
        for item in items:
            answer = self.refuse(item, session.user)
            if answer is None and not self._has_shape(item):
                answer = Answer(_Codes.BadTypeMismatch)
            if answer is None:
                value = (item.NodeId, item.AttributeId, item.Value)
                answer = Answer((yield self._space.write_attribute_value(*value)).value)
            answers.append(answer)
            yield
        return answers

    def _has_shape(self, item: ua.WriteValue) -> bool:
        """Whether there is a value, and an array where one is expected; asyncua checks the type."""
        variant = item.Value.Value
        rank = (
            self._space[item.NodeId].attributes[_Attributes.ValueRank].value.Value.Value
        )
        return (
            variant is not None
            and variant.Value is not None
            and variant.is_array == (rank >= 0)
        )

    def is_method(self, method_id: ua.NodeId) -> bool:
        """Whether there is something to call."""
        node = self._space.get(method_id)
        return node is not None and node.call is not None

    async def call(self, request: ua.CallMethodRequest, session: Any) -> CallAnswer:
        """Answer one call of an existing method."""
        owner = self._space.get(request.ObjectId)
        if owner is None or not any(
            r.IsForward and r.NodeId == request.MethodId for r in owner.references
        ):
            return refused(
                _Codes.BadMethodInvalid, "the method belongs to another object"
            )
        if not self.may_call(session.user, request.MethodId):
            return refused(
                _Codes.BadUserAccessDenied, "your role does not allow this call"
            )
        name = self.name_of(request.MethodId)
        wanted = self._arguments(self._space[request.MethodId])
        wrong = _check_arguments(name, wanted, request.InputArguments or [])
        if wrong is not None:
            return wrong
        return await self.run(request)

    async def run(self, request: ua.CallMethodRequest) -> CallAnswer:
        """Run the method; the arguments have been checked."""
        (result,) = await self._server.method_service.call([request])
        return CallAnswer(result)

    def _arguments(self, method: Any) -> list[ua.Argument]:
        for reference in method.references:
            if reference.IsForward and reference.BrowseName == _INPUT_ARGUMENTS:
                place = self._space[reference.NodeId].attributes[_Attributes.Value]
                return list(place.value.Value.Value or ())
        return []


def _check_arguments(
    name: str, wanted: Sequence[ua.Argument], given: Sequence[ua.Variant]
) -> CallAnswer | None:
    signature = (
        ", ".join(f"{_type_name(a.DataType)} {a.Name}" for a in wanted)
        or "no arguments"
    )
    text = f"{name} takes {signature}"
    if len(given) != len(wanted):
        is_short = len(given) < len(wanted)
        return refused(
            _Codes.BadArgumentsMissing if is_short else _Codes.BadTooManyArguments, text
        )
    results = [
        ua.StatusCode(_Codes.Good if _fits(argument, value) else _Codes.BadTypeMismatch)
        for argument, value in zip(wanted, given, strict=True)
    ]
    if any(result.value != _Codes.Good for result in results):
        return refused(_Codes.BadInvalidArgument, text, results)
    return None


def _type_name(data_type: ua.NodeId) -> str:
    is_standard = data_type.NamespaceIndex == 0
    return str(
        ua.ObjectIdNames.get(data_type.Identifier)
        if is_standard
        else data_type.to_string()
    )


def _fits(argument: ua.Argument, given: ua.Variant) -> bool:
    kind = argument.DataType
    rank = argument.ValueRank
    is_built_in = kind.NamespaceIndex == 0 and kind.Identifier in _BUILT_IN
    if is_built_in and given.VariantType.value != kind.Identifier:
        return False
    has_rank = given.is_array if rank >= 1 else not given.is_array or rank != _SCALAR
    return has_rank and given.Value is not None

"""What clients write: checked before it enters, so that the status code is the gate's answer.

=====================  =========================================================================
BadTypeMismatch        another data type, scalar for array, wrong length (no widening: an Int64 is
                       no Double)
BadOutOfRange          outside EURange, NaN, infinity
BadUserAccessDenied    another source has control, or the user's role does not allow it; the
                       diagnostic text and an event say who has control
BadNotWritable         an output, or another attribute than Value
BadWriteNotSupported   with an index range or with a status code that is not Good
BadResourceUnavailable the queue of the plant is full
=====================  =========================================================================

A time stamp that comes with a value is ignored: the stamp is that of the tick that latched it.
"""

from collections.abc import Callable, Generator, Iterable
from typing import Any, NamedTuple

from asyncua import ua
from asyncua.crypto.permission_rules import User

from hilserver.core.inputs import InputGate, Refusal, check_value, kind_of
from hilserver.core.leases import NOBODY
from hilserver.errors import ControlRefused
from hilserver.image import ProcessImage
from hilserver.io.opcua_server.access import Access
from hilserver.io.opcua_server.model import CONTROL_SOURCE, DATA_TYPES
from hilserver.io.opcua_server.values import SignalVariables
from hilserver.signals import Signal, SignalTable

SOURCE = "opcua"
"""Name under which the clients of this server write, but for the operator page."""

_Codes = ua.StatusCodes
STATUS_OF: dict[Refusal, int] = {
    Refusal.UNKNOWN_SIGNAL: _Codes.BadNodeIdUnknown,
    Refusal.NOT_WRITABLE: _Codes.BadNotWritable,
    Refusal.TYPE_MISMATCH: _Codes.BadTypeMismatch,
    Refusal.NOT_FINITE: _Codes.BadOutOfRange,
    Refusal.OUT_OF_RANGE: _Codes.BadOutOfRange,
    Refusal.NOT_IN_CONTROL: _Codes.BadUserAccessDenied,
    Refusal.QUEUE_FULL: _Codes.BadResourceUnavailable,
}


class Answer(NamedTuple):
    """Result of one write: status code, and a sentence where it is refused."""

    code: int
    text: str = ""


_ACCEPTED = Answer(_Codes.Good)


class WriteDoor:
    """Answers the Write service.

    Parameters
    ----------
    address_space : asyncua AddressSpace
        Asked which nodes and attributes exist.
    variables : SignalVariables
        Shows what was accepted.
    show_owner : callable
        Shows who has control, once that may have changed.
    """

    def __init__(
        self,
        address_space: Any,
        namespace_index: int,
        table: SignalTable,
        image: ProcessImage,
        gate: InputGate,
        variables: SignalVariables,
        access: Access,
        show_owner: Callable[[], None],
    ) -> None:
        self._show_owner = show_owner
        self._address_space = address_space
        self._index = namespace_index
        self._table = table
        self._image = image
        self._gate = gate
        self._variables = variables
        self._access = access

    def write(
        self,
        items: Iterable[ua.WriteValue],
        user: User,
        source: str = SOURCE,
        holder: object = None,
    ) -> Generator[None, None, list[Answer]]:
        """Return one answer per item; what is accepted is latched together by one tick.

        Gives way while the items are judged, and between groups that are latched apart.
        """
        items = list(items)
        answers: list[Answer] = []
        group: dict[str, tuple[int, object]] = {}
        for position, item in enumerate(items):
            yield
            answer = self._refuse(item, user)
            answers.append(answer or _ACCEPTED)
            if answer is not None:
                continue
            name = item.NodeId.Identifier
            if name == CONTROL_SOURCE or name in group:
                # The order of a request holds: taking control acts on the writes behind it, and
                # of two writes to one signal the later wins.
                self._hand_over(group, answers, source)
                group = {}
            if name == CONTROL_SOURCE:
                answers[position] = self._take_control(item.Value.Value, source, holder)
            else:
                group[name] = (position, self._value(self._table[name], item.Value.Value))
        self._hand_over(group, answers, source)
        return answers

    def _refuse(self, item: ua.WriteValue, user: User) -> Answer | None:
        node = self._address_space.get(item.NodeId)
        if node is None:
            return Answer(_Codes.BadNodeIdUnknown)
        if item.AttributeId not in node.attributes:
            return Answer(_Codes.BadAttributeIdInvalid)
        name = item.NodeId.Identifier
        is_ours = item.NodeId.NamespaceIndex == self._index and isinstance(name, str)
        if item.AttributeId != ua.AttributeIds.Value or not is_ours:
            return Answer(_Codes.BadNotWritable, "only the values of inputs can be written")
        if name != CONTROL_SOURCE and name not in self._table:
            return Answer(_Codes.BadNotWritable, "only the values of inputs can be written")
        if not self._access.may_write(user, name):
            return Answer(_Codes.BadUserAccessDenied, "your role does not allow to write this")
        if item.IndexRange:
            return Answer(_Codes.BadWriteNotSupported, "write the whole array")
        if item.Value.StatusCode is not None and item.Value.StatusCode.value != _Codes.Good:
            return Answer(
                _Codes.BadWriteNotSupported, "only values with status Good can be written"
            )
        return None

    @staticmethod
    def _value(signal: Signal, variant: ua.Variant) -> object:
        """Return the plain value, or what the gate refuses, counts and names as another type."""
        value = variant.Value
        if isinstance(value, list) and len(value) > len(signal.slots):
            return f"{len(value)} elements"  # nobody wants to read a million of them in the log
        return value if variant.VariantType.value == DATA_TYPES[signal.type] else variant

    def _hand_over(
        self, group: dict[str, tuple[int, object]], answers: list[Answer], source: str
    ) -> None:
        if not group:
            return
        values = {name: value for name, (_, value) in group.items()}
        refused = self._gate.write(source, values)
        for name, reason in refused.items():
            answers[group[name][0]] = Answer(STATUS_OF[reason], self._explain(name, reason, source))
        accepted: dict[str, tuple[float, ...]] = {}
        for name, value in values.items():
            numbers = check_value(self._table[name], value)
            if name not in refused and not isinstance(numbers, Refusal):
                accepted[name] = numbers
        if accepted:
            self._variables.show_written(accepted, self._image.pushed_rows)

    def _take_control(self, variant: ua.Variant, source: str, holder: object) -> Answer:
        if variant.VariantType != ua.VariantType.String or variant.is_array:
            return Answer(_Codes.BadTypeMismatch, "control.source is a String")
        if variant.Value not in (*self._gate.priority, NOBODY):
            known = ", ".join(self._gate.priority)
            return Answer(_Codes.BadOutOfRange, f"sources are {known}")
        try:
            self._gate.request(kind_of(source), variant.Value, holder)
        except ControlRefused as error:
            return Answer(_Codes.BadUserAccessDenied, str(error))
        self._show_owner()
        return _ACCEPTED

    def _explain(self, name: str, reason: Refusal, source: str) -> str:
        signal = self._table[name]
        if reason is Refusal.NOT_IN_CONTROL:
            kind = kind_of(source)
            return f"'{self._gate.owner}' has control; write '{kind}' to {CONTROL_SOURCE} first"
        if reason is Refusal.OUT_OF_RANGE:
            return f"the range is {signal.range_text}"
        if reason is Refusal.TYPE_MISMATCH:
            length = f"[{len(signal.slots)}]" if signal.is_array else ""
            return f"the type is {signal.type.value}{length}"
        return reason.value.replace("_", " ")

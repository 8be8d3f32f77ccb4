"""The robot behind its OPC UA server: its clients, and what they write and call.

Values are checked on entry, so that the status code is the gate's answer. In addition to the codes
of `hilserver.opcua.application`:

======================  ========================================================================
BadTypeMismatch         another data type, wrong length (no widening: an Int64 is not a Double)
BadOutOfRange           outside EURange, NaN, infinity
BadUserAccessDenied     another source or person has control; the diagnostic text and an event
                        name it; of a method: one that disturbs the person who drives
BadResourceUnavailable  the queue of the plant is full
BadInvalidState         it arrived before Reset, Pause or LoadSnapshot discarded the commands, or
                        a hand that was held over them has not let go since, or an automatic
                        source waits for Start
BadInvalidArgument      of a method: also a value out of range
BadInvalidState         a method that is not possible now; the diagnostic text has the reason
BadNotImplemented       Force, Unforce, InjectFault, ClearFaults on a server without faults
======================  ========================================================================

A time stamp that comes with a value is ignored: the stamp is that of the tick that latched it.
"""

import inspect
import itertools
import secrets
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from typing import Any

from asyncua import ua

from hilserver.core.events import Event, EventKind
from hilserver.core.inputs import InputGate
from hilserver.core.leases import NOBODY, TELEOP, kind_of
from hilserver.core.refusal import Refusal, check_value
from hilserver.core.rest import is_hand, is_terminal
from hilserver.errors import ControlRefused, UserError
from hilserver.image import ProcessImage
from hilserver.io.arrival import came_ns
from hilserver.io.opcua_server.method_table import CALLER, METHODS, Method, Parts
from hilserver.io.opcua_server.model import CONTROL_SOURCE, DATA_TYPES, SHELL
from hilserver.io.opcua_server.parameters import ParameterVariables
from hilserver.io.opcua_server.values import SignalVariables
from hilserver.opcua.application import (
    ACCEPTED,
    Answer,
    Application,
    CallAnswer,
    Visitor,
    refused,
)
from hilserver.opcua.logs import log
from hilserver.opcua.settings import Role
from hilserver.plant.layout import N_SETPOINTS
from hilserver.signals import Signal, SignalTable

# name under which clients of this server write, except the operator page
SOURCE = "opcua"

_Codes = ua.StatusCodes
STATUS_OF: dict[Refusal, int] = {
    Refusal.UNKNOWN_SIGNAL: _Codes.BadNodeIdUnknown,
    Refusal.NOT_WRITABLE: _Codes.BadNotWritable,
    Refusal.TYPE_MISMATCH: _Codes.BadTypeMismatch,
    Refusal.NOT_FINITE: _Codes.BadOutOfRange,
    Refusal.OUT_OF_RANGE: _Codes.BadOutOfRange,
    Refusal.NOT_IN_CONTROL: _Codes.BadUserAccessDenied,
    Refusal.QUEUE_FULL: _Codes.BadResourceUnavailable,
    Refusal.OUTDATED: _Codes.BadInvalidState,
    Refusal.NOT_AT_REST: _Codes.BadInvalidState,
    Refusal.NOT_STARTED: _Codes.BadInvalidState,
    Refusal.NOT_GRANTED: _Codes.BadUserAccessDenied,
    Refusal.INCOMPLETE: _Codes.BadInvalidState,
}


@dataclass(frozen=True, slots=True)
class RobotVisitor(Visitor):
    """A client of the robot."""

    # under which its writes reach the plant: ``opcua``, ``opcua:teleop:<n>`` or ``page:<n>``
    source: str = SOURCE
    # control is passed on when it ends; False for the shell, whose sessions last one command
    may_hold_control: bool = True


class RobotApplication(Application):
    """Answers for the robot."""

    def __init__(
        self,
        server: Any,
        namespace_index: int,
        table: SignalTable,
        image: ProcessImage,
        gate: InputGate,
        variables: SignalVariables,
        parameters: ParameterVariables,
        parts: Parts,
        show_owner: Callable[[], None],
    ) -> None:
        super().__init__(server, server.access)
        self._index = namespace_index
        self._table = table
        self._image = image
        self._gate = gate
        self._variables = variables
        self._parts = parts
        self._show_owner = show_owner
        self._parameters = parameters
        self._methods = {ua.NodeId(m.node_id, namespace_index): m for m in METHODS}
        # marks sessions of the operator page, as the first word of their session name
        self.page_secret = secrets.token_hex(32)
        self._numbers = itertools.count(1)

    # --- clients ----------------------------------------------------------------------------------

    def visitor(self, session_name: str, address: str) -> RobotVisitor:
        """Return the visitor for a client; one that knows the secret is the page.

        The page runs here, so it gives its user's address as the second word. A teleoperation
        may claim to be one: all it gains is the dead-man.
        """
        first, _, rest = session_name.partition(" ")
        if secrets.compare_digest(first.encode(), self.page_secret.encode()):
            user_address = rest.partition(" ")[0]
            source = f"page:{next(self._numbers)}"
            return RobotVisitor(user_address, has_own_place=True, source=source)
        # One number each: two terminals neither share a rest nor mix their set-points.
        source = f"{TELEOP}:{next(self._numbers)}" if first == "teleop" else SOURCE
        return RobotVisitor(address, source=source, may_hold_control=first != SHELL)

    def left(self, session: Any) -> None:
        """Pass control on if the client that has left held it."""
        self._gate.gone(session)
        self._show_owner()

    def has_reserve(self, user: Any) -> bool:
        """Whether a user may stop the robot."""
        return self._access.may_call(user, "Stop")

    def name_of(self, node_id: ua.NodeId) -> str:
        """Return the name of a signal or method."""
        return super().name_of(node_id).removeprefix("methods.")

    # --- writes -----------------------------------------------------------------------------------

    def is_writable(self, node_id: ua.NodeId) -> bool:
        """Whether a variable is a parameter, or a signal: the gate knows which are inputs."""
        name = node_id.Identifier
        is_ours = node_id.NamespaceIndex == self._index
        return is_ours and (
            name == CONTROL_SOURCE or name in self._table or name in self._parameters
        )

    def may_write(self, user: Any, node_id: ua.NodeId) -> bool:
        """Whether a user may write a variable; only an engineer changes the robot itself."""
        is_parameter = node_id.Identifier in self._parameters
        return super().may_write(user, node_id) and (
            not is_parameter or user.rights >= Role.ENGINEER
        )

    def write(
        self, items: Iterable[ua.WriteValue], session: Any
    ) -> Generator[Any, Any, list[Answer]]:
        """Return one answer per item; accepted ones are latched together by one tick.

        Of a command, an item that is refused takes the others of the request with it, wherever in
        the request they are. Yields while the items are judged.
        """
        received_ns = came_ns(session.processor.socket)
        answers: list[Answer] = []
        broken: set[str] = set()
        items = list(items)
        for item in items:
            yield
            answer = self.refuse(item, session.user)
            answers.append(answer or ACCEPTED)
            name = item.NodeId.Identifier
            is_alone = name == CONTROL_SOURCE or name in self._parameters
            if not is_alone and (answer is not None or self._is_unsound(item)):
                broken.add(str(name))

        group: dict[str, tuple[int, object]] = {}
        changes: dict[str, tuple[int, ua.Variant]] = {}
        for position, item in enumerate(items):
            if answers[position] is not ACCEPTED:
                continue
            name = item.NodeId.Identifier
            if name in self._parameters:
                changes[name] = (position, item.Value.Value)
                continue
            if name == CONTROL_SOURCE or name in group:
                # The order of a request counts: taking control affects the writes after it, and
                # the later of two writes to one signal wins.
                self._hand_over(group, answers, session, received_ns, broken)
                group = {}
            if name == CONTROL_SOURCE:
                answers[position] = self._take_control(item.Value.Value, session)
            else:
                group[name] = (position, _plain(self._table[name], item.Value.Value))
        self._hand_over(group, answers, session, received_ns, broken)
        self._change(changes, answers, session.visitor.source)
        return answers

    def _is_unsound(self, item: ua.WriteValue) -> bool:
        """Whether a signal cannot have this value, whoever has control."""
        name = item.NodeId.Identifier
        if name not in self._table:
            return False
        signal = self._table[name]
        value = _plain(signal, item.Value.Value)
        checked = check_value(signal, value)
        return isinstance(checked, Refusal)

    def _change(
        self,
        changes: dict[str, tuple[int, ua.Variant]],
        answers: list[Answer],
        source: str,
    ) -> None:
        """Change parameters, all in one tick."""
        written = {name: variant for name, (_, variant) in changes.items()}
        for name, (reason, text) in self._parameters.write(source, written).items():
            answers[changes[name][0]] = Answer(STATUS_OF[reason], text)

    def _hand_over(
        self,
        group: dict[str, tuple[int, object]],
        answers: list[Answer],
        session: Any,
        received_ns: int,
        broken: set[str],
    ) -> None:
        if not group:
            return
        source = session.visitor.source
        values = {name: value for name, (_, value) in group.items()}
        other = self._other_driver(session)
        if other and kind_of(source) == self._gate.owner:
            for name in [name for name in values if not self._table[name].is_measured]:
                answers[group[name][0]] = Answer(_Codes.BadUserAccessDenied, other)
                del values[name]
        if not values:
            return
        turned_down = self._gate.write(
            source, values, received_ns=received_ns, broken=broken
        )
        for name, reason in turned_down.items():
            why = self._gate.explain(source, name, reason)
            answers[group[name][0]] = Answer(STATUS_OF[reason], why)
        accepted = {
            name: self._gate.accepted_value(name)
            for name in values.keys() - turned_down
        }
        if accepted:
            if kind_of(source) == SOURCE and session.processor is not None:
                self._gate.present.add(session)
                slots = [slot for name in accepted for slot in self._table[name].slots]
                client = session if session.visitor.may_hold_control else None
                self._gate.commanded(
                    (slot for slot in slots if slot < N_SETPOINTS), client
                )
            self._variables.show_written(accepted, self._image.pushed_rows)

    def _take_control(self, variant: ua.Variant, session: Any) -> Answer:
        if variant.VariantType != ua.VariantType.String or variant.is_array:
            return Answer(_Codes.BadTypeMismatch, "control.source is a String")
        if variant.Value not in (*self._gate.priority, NOBODY):
            known = ", ".join(self._gate.priority)
            return Answer(_Codes.BadOutOfRange, f"sources are {known}")
        kind = kind_of(session.visitor.source)
        other = self._other_driver(session)
        if other and kind == self._gate.owner != variant.Value:
            return Answer(_Codes.BadUserAccessDenied, other)
        holder = session if session.visitor.may_hold_control else None
        try:
            self._gate.request(kind, variant.Value, holder)
        except ControlRefused as error:
            return Answer(_Codes.BadUserAccessDenied, str(error))
        self._show_owner()
        return ACCEPTED

    def _other_driver(self, session: Any) -> str:
        """Return a sentence if another person drives, and a person asks.

        Programs, as test stands, do not look on: what they may is up to their role.
        """
        holder = self._gate.holder
        if not is_hand(session.visitor.source):
            return ""
        if holder is None or holder is session or not is_hand(holder.visitor.source):
            return ""
        by = "a terminal" if is_terminal(holder.visitor.source) else "the page"
        return f"{_name_of(holder)} drives by {by}: take control first"

    # --- calls ------------------------------------------------------------------------------------

    def is_method(self, method_id: ua.NodeId) -> bool:
        """Whether it is one of ours."""
        return method_id in self._methods

    async def call(self, request: ua.CallMethodRequest, session: Any) -> CallAnswer:
        """Answer one call; the method can see who called."""
        who = _name_of(session)
        method = self._methods.get(request.MethodId)
        if method is not None and method.disturbs:
            other = self._other_driver(session)
        else:
            other = ""
        if other and self.may_call(session.user, request.MethodId):
            return refused(_Codes.BadUserAccessDenied, other)
        mine = CALLER.set(who)
        try:
            answer = await super().call(request, session)
        finally:
            CALLER.reset(mine)
        if (
            method is None or method.name == "ResetStatistics"
        ):  # which changes nothing in the plant
            return answer
        if answer.result.StatusCode.is_good():
            said = [
                f"{argument.Value!r:.60}" for argument in request.InputArguments or ()
            ]
            text = f"{method.name}({', '.join(said)}) by {who}"
            self._gate.publish(
                Event(EventKind.STATE, 200, session.visitor.source, text)
            )
        if answer.text and method.refused is not None:
            why = answer.text.removeprefix(f"{method.name}: ")
            method.refused(self._parts, f"{method.name} by {who} was refused: {why}")
        return answer

    async def run(self, request: ua.CallMethodRequest) -> CallAnswer:
        """Run a method; its arguments already have their types."""
        method = self._methods[request.MethodId]
        values = [argument.Value for argument in request.InputArguments or ()]
        answer = await self._act(method, values)
        log.info("opcua method", method=method.name, refused=answer.text or None)
        return answer

    async def _act(self, method: Method, values: list[Any]) -> CallAnswer:
        try:
            outcome = method.act(self._parts, *values)
            if inspect.isawaitable(outcome):
                await outcome
        except NotImplementedError as error:
            return refused(_Codes.BadNotImplemented, str(error))
        except UserError as error:
            return refused(_Codes.BadInvalidState, str(error))
        except ValueError as error:
            results = [ua.StatusCode(_Codes.BadOutOfRange) for _ in values]
            return refused(_Codes.BadInvalidArgument, str(error), results)
        except OSError as error:
            return refused(_Codes.BadResourceUnavailable, str(error))
        except Exception as error:  # noqa: BLE001 - a client must get an answer, and no traceback
            log.error("opcua method failed", method=method.name, error=repr(error))
            return refused(_Codes.BadInternalError, "internal error, see the log")
        return CallAnswer(ua.CallMethodResult(StatusCode=ua.StatusCode(_Codes.Good)))


def _name_of(session: Any) -> str:
    """Return the user of a session, for people."""
    return session.user.name or f"anonymous {session.user.rights.name.lower()}"


def _plain(signal: Signal, variant: ua.Variant) -> object:
    """Return the plain value, or one that the gate refuses and counts as a wrong type."""
    value = variant.Value
    if isinstance(value, list) and len(value) > len(signal.slots):
        return f"{len(value)} elements"  # not a million values in the log
    is_ours = variant.VariantType.value == DATA_TYPES[signal.type]
    return value if is_ours else f"{value!r:.40} of type {variant.VariantType.name}"

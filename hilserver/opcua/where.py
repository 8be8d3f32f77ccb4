"""Where clauses of event filters (OPC 10000-4, 7.7.3): checked and compiled when they are created.

A clause is a tree: an element refers to later ones, each at most once, so that an event costs no
more than its elements. A clause with a circle or a shared element, or one that is too long, is
refused before the first event comes.
"""

import operator
from collections.abc import Callable
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError

from hilserver.opcua.browsing import TypeTree

MAX_ELEMENTS = 100
MAX_OPERANDS = 500  # of all elements together: InList may have many
MAX_DEPTH = 20
_Op, _Codes = ua.FilterOperator, ua.StatusCodes
Evaluate = Callable[[Any], Any]

_COMPARED: dict[Any, Callable[[Any, Any], Any]] = {
    _Op.Equals: operator.eq,
    _Op.GreaterThan: operator.gt,
    _Op.LessThan: operator.lt,
    _Op.GreaterThanOrEqual: operator.ge,
    _Op.LessThanOrEqual: operator.le,
}
_LEAST_OPERANDS = {
    _Op.IsNull: 1, _Op.Not: 1, _Op.OfType: 1, _Op.Between: 3, _Op.InList: 2, _Op.And: 2,
    _Op.Or: 2, **dict.fromkeys(_COMPARED, 2),
}  # fmt: skip


def compile_where(clause: ua.ContentFilter, types: TypeTree) -> Evaluate:
    """Return a function that decides whether an event passes.

    ServiceError: BadEventFilterInvalid if it is not a tree or too long,
    BadFilterOperatorUnsupported, BadFilterOperandCountMismatch and BadFilterOperandInvalid for
    single elements.
    """
    elements = clause.Elements or []
    if not elements:
        return lambda _: True
    n_operands = sum(len(element.FilterOperands or ()) for element in elements)
    if len(elements) > MAX_ELEMENTS or n_operands > MAX_OPERANDS:
        raise ServiceError(_Codes.BadEventFilterInvalid)
    evaluate = _Compiler(elements, types).element(0, 0)

    def passes(event: Any) -> bool:
        try:
            return bool(evaluate(event))
        except TypeError:
            return False  # neither of two values that cannot be compared is greater

    return passes


class _Compiler:
    def __init__(self, elements: list[Any], types: TypeTree) -> None:
        self._elements = elements
        self._types = types
        self._named = {0}

    def element(self, index: int, depth: int) -> Evaluate:
        element = self._elements[index]
        kind = element.FilterOperator
        operands = element.FilterOperands or []
        least = _LEAST_OPERANDS.get(kind)
        if least is None:
            raise ServiceError(_Codes.BadFilterOperatorUnsupported)
        if len(operands) < least:
            raise ServiceError(_Codes.BadFilterOperandCountMismatch)
        if depth > MAX_DEPTH:
            raise ServiceError(_Codes.BadEventFilterInvalid)
        values = [self._operand(o, index, depth) for o in operands]
        first = values[0]
        second = values[-1]
        if kind in _COMPARED:
            compare = _COMPARED[kind]
            return lambda event: compare(first(event), values[1](event))
        if kind == _Op.IsNull:
            return lambda event: first(event) is None
        if kind == _Op.Not:
            return lambda event: not first(event)
        if kind == _Op.And:
            return lambda event: first(event) and values[1](event)
        if kind == _Op.Or:
            return lambda event: first(event) or values[1](event)
        if kind == _Op.Between:
            return lambda event: values[1](event) <= first(event) <= values[2](event)
        if kind == _Op.InList:
            return lambda event: first(event) in [value(event) for value in values[1:]]
        return lambda event: (
            event.field("EventType") in self._types.closure(second(event))
        )

    def _operand(self, operand: Any, index: int, depth: int) -> Evaluate:
        if isinstance(operand, ua.ElementOperand):
            # Only forwards, and each once: no circles, no element evaluated twice.
            is_out_of_place = not index < operand.Index < len(self._elements)
            if is_out_of_place or operand.Index in self._named:
                raise ServiceError(_Codes.BadEventFilterInvalid)
            self._named.add(operand.Index)
            return self.element(operand.Index, depth + 1)
        if isinstance(operand, ua.LiteralOperand):
            value = None if operand.Value is None else operand.Value.Value
            return lambda _: value
        if isinstance(operand, ua.SimpleAttributeOperand):
            names = operand.BrowsePath or []
        elif isinstance(operand, ua.AttributeOperand):
            names = [part.TargetName for part in operand.BrowsePath.Elements or ()]
        else:
            raise ServiceError(_Codes.BadFilterOperandInvalid)
        name = "/".join(part.Name or "" for part in names)
        return lambda event: event.field(name)

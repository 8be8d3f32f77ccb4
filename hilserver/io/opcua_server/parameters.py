"""The parameters in the address space: one variable each, updated when it changes."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from asyncua import ua

from hilserver.core.parameters import LiveParameters, Refused
from hilserver.core.refusal import Refusal
from hilserver.io.opcua_server.model import PARAMETERS
from hilserver.opcua.encoding import FixedDataValue

_DOUBLE = ua.VariantType.Double


class ParameterVariables:
    """Values of the parameters, and what clients write."""

    def __init__(
        self, parameters: LiveParameters | None, place: Callable[[str], Any]
    ) -> None:
        self._parameters = parameters
        names = () if parameters is None else parameters.table
        self._places = {PARAMETERS + name: place(PARAMETERS + name) for name in names}
        self._source: object = None
        self._shown: dict[str, float] = {}
        self.publish()

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def publish(self) -> None:
        """Show what has changed."""
        if self._parameters is None or self._parameters.values is self._source:
            return
        values = self._parameters.values
        for name, value in values.items():
            before = self._shown.get(name, math.inf)
            if value != before and not (math.isnan(value) and math.isnan(before)):
                self._places[PARAMETERS + name].value = FixedDataValue.good(
                    value, _DOUBLE
                )
        self._source, self._shown = values, dict(values)

    def write(
        self, source: str, written: Mapping[str, ua.Variant]
    ) -> dict[str, Refused]:
        """Change parameters, all in one tick; return refusals by the name of the node."""
        refused: dict[str, Refused] = {}
        values: dict[str, object] = {}
        for node, variant in written.items():
            if variant.VariantType != _DOUBLE or variant.is_array:
                refused[node] = Refused(Refusal.TYPE_MISMATCH, "the type is Double")
            else:
                values[node.removeprefix(PARAMETERS)] = variant.Value
        if self._parameters is None:
            found = {}
        else:
            found = self._parameters.write(source, values)
        self.publish()
        return refused | {PARAMETERS + name: why for name, why in found.items()}

"""The robot's parameters as those of a ROS 2 node: `rcl_interfaces` get, set, list, describe.

A parameter is a double; NaN is null. `ros2 param set` sends whole numbers as integers, which are
accepted as doubles. All parameters of one request change in one tick.
"""

from collections.abc import Iterator
from math import inf, isfinite, nan
from typing import Any, Final

from hilserver.core.parameters import LiveParameters
from hilserver.errors import ControlRefused
from hilserver.parameters import Parameter
from hilserver.plant.errors import PlantError
from hilserver.ros.flavours import Served
from hilserver.ros.types import Types

NODE: Final = "hilserver"
NOT_SET, BOOL, INTEGER, DOUBLE, STRING = range(5)  # of rcl_interfaces/msg/ParameterType
_NOT_ALLOWED: Final = (
    "setting parameters is not granted here: ros2.grants: [parameters] does"
)
_SERVICES: Final = (
    ("get_parameters", "GetParameters"),
    ("get_parameter_types", "GetParameterTypes"),
    ("set_parameters", "SetParameters"),
    ("set_parameters_atomically", "SetParametersAtomically"),
    ("list_parameters", "ListParameters"),
    ("describe_parameters", "DescribeParameters"),
)


class ParameterServices:
    """Parameter services of the node."""

    def __init__(
        self,
        source: str,
        parameters: LiveParameters,
        types: Types,
        *,
        may_set: bool = True,
    ) -> None:
        self._source, self._parameters, self._types = source, parameters, types
        self._may_set = may_set

    def served(self) -> Iterator[Served]:
        """Yield the services."""
        for name, kind in _SERVICES:
            full, act = f"rcl_interfaces/srv/{kind}", getattr(self, name)

            def serve(_: Any, request: Any, act: Any = act, full: str = full) -> Any:
                response = self._types.make(f"{full}_Response", **act(request))
                return {}, lambda _: response

            yield Served(f"{NODE}/{name}", full, serve)

    def _make(self, kind: str, **fields: Any) -> Any:
        return self._types.make(f"rcl_interfaces/msg/{kind}", **fields)

    # --- one each ---------------------------------------------------------------------------------

    def get_parameters(self, request: Any) -> dict[str, Any]:
        """Return the values; none for an unknown name."""
        values = self._parameters.values
        return {"values": [self._value(values.get(name)) for name in request.names]}

    def get_parameter_types(self, request: Any) -> dict[str, Any]:
        """Return double, or not set for an unknown name."""
        known = self._parameters.table
        return {
            "types": _array(
                DOUBLE if name in known else NOT_SET for name in request.names
            )
        }

    def set_parameters(self, request: Any) -> dict[str, Any]:
        """Change the valid ones; answer for each."""
        if not self._may_set:
            return {"results": [self._result(_NOT_ALLOWED) for _ in request.parameters]}
        refused = self._parameters.write(self._source, _values(request))
        return {
            "results": [
                self._result(refused[p.name].text if p.name in refused else "")
                for p in request.parameters
            ]
        }

    def set_parameters_atomically(self, request: Any) -> dict[str, Any]:
        """Change all, or nothing."""
        if not self._may_set:
            return {"result": self._result(_NOT_ALLOWED)}
        try:
            self._parameters.apply(self._parameters.checked(_values(request)))
        except (PlantError, ControlRefused) as error:
            return {"result": self._result(str(error))}
        return {"result": self._result("")}

    def list_parameters(self, request: Any) -> dict[str, Any]:
        """Return names below prefixes, down to a depth; 0 is no limit."""
        found = [n for n in self._parameters.table if _is_asked_for(n, request)]
        above = dict.fromkeys(n.rpartition(".")[0] for n in found)
        result = self._make(
            "ListParametersResult", names=found, prefixes=[p for p in above if p]
        )
        return {"result": result}

    def describe_parameters(self, request: Any) -> dict[str, Any]:
        """Return meaning and range."""
        table = self._parameters.table
        return {
            "descriptors": [
                self._descriptor(name, table.get(name)) for name in request.names
            ]
        }

    # --- parts of the answers ---------------------------------------------------------------------

    def _value(self, value: float | None) -> Any:
        return self._make(
            "ParameterValue",
            type=NOT_SET if value is None else DOUBLE,
            bool_value=False,
            integer_value=0,
            double_value=0.0 if value is None else value,
            string_value="",
            byte_array_value=_array(()),
            bool_array_value=_array((), "bool"),
            integer_array_value=_array((), "int64"),
            double_array_value=_array((), "float64"),
            string_array_value=[],
        )

    def _result(self, reason: str) -> Any:
        return self._make("SetParametersResult", successful=not reason, reason=reason)

    def _descriptor(self, name: str, parameter: Parameter | None) -> Any:
        ranges = []
        if parameter is not None:
            low, high = parameter.low, parameter.high
            ranges = [
                self._make(
                    "FloatingPointRange", from_value=low, to_value=high, step=0.0
                )
            ]
        return self._make(
            "ParameterDescriptor",
            name=name,
            type=NOT_SET if parameter is None else DOUBLE,
            description="" if parameter is None else parameter.meaning,
            additional_constraints="" if parameter is None else _constraints(parameter),
            read_only=parameter is not None and parameter.when == "restart",
            dynamic_typing=False,
            floating_point_range=ranges,
            integer_range=[],
        )


def _constraints(parameter: Parameter) -> str:
    names = parameter.names_text
    return parameter.range_text + (f", {names}" if names else "")


def _array(numbers: Any, kind: str = "uint8") -> Any:
    import numpy as np  # noqa: PLC0415 -- rosbags takes nothing else

    return np.array(list(numbers), dtype=kind)


def _values(request: Any) -> dict[str, object]:
    return {parameter.name: _plain(parameter.value) for parameter in request.parameters}


def _plain(value: Any) -> object:
    if value.type == DOUBLE:
        return value.double_value
    if value.type == BOOL:
        return bool(value.bool_value)
    if value.type == STRING:
        return str(value.string_value)
    if value.type == INTEGER:
        number = float(value.integer_value)
        return number if isfinite(number) else inf
    return nan if value.type == NOT_SET else f"parameter of type {value.type}"


def _is_asked_for(name: str, request: Any) -> bool:
    depth = int(request.depth)
    if not request.prefixes:
        return depth == 0 or name.count(".") < depth
    for prefix in request.prefixes:
        is_near = depth == 0 or name.removeprefix(prefix).count(".") <= depth
        if name == prefix or (name.startswith(f"{prefix}.") and is_near):
            return True
    return False

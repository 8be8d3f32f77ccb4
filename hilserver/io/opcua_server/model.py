"""The address space of a signal table as plain data, before any OPC UA library.

The running server and the NodeSet2 file are both made from these rows, so they cannot differ.
A dotted name gives the place: ``wheel.fl.speed_rpm`` is variable ``speed_rpm`` in folder
``wheel.fl``; its node id is always the whole name.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hilserver.errors import ConfigError
from hilserver.io.opcua_server.method_table import STRING
from hilserver.io.opcua_server.units import UNECE, Unit, find_unit
from hilserver.signals import Signal, SignalTable, ValueType

if TYPE_CHECKING:  # clients also use these names, and need no compiler
    from hilserver.parameters import Parameter

NAMESPACE_URI = "urn:hilserver:robot"
DI_NAMESPACE_URI = "http://opcfoundation.org/UA/DI/"
DI_VERSION = "1.04"  # of OPC 10000-100, whose names we use
# numeric identifier of DeviceSet in the DI namespace (OPC 10000-100)
DI_DEVICE_SET = 5001

ROBOT = "robot"  # node id of the object that holds all our nodes
GROUPS = {
    "methods": "Commands to the daemon",
    "slices": "Timing of every time slice",
    "peers": "Links to OPC UA peers",
    "audit": "What this computer lacks for real time, and insecure settings",
    "faults": "Injected faults and forced signals",
    "recalibration": "Proposals for keeping the model in step with the robot",
    "parameters": "Numbers of the robot that can change while it runs",
}
"""Folders of nodes that are not signals."""
PARAMETERS = "parameters."  # prefix of the node ids of parameters
CONTROL_SOURCE = "control.source"
SHELL = "shell"  # prefix of the names of sessions that last for one command

ANALOG_ITEM, ANALOG_UNIT, ANALOG_UNIT_RANGE = 2368, 17497, 17570
BASE_DATA_VARIABLE, TWO_STATE, MULTI_STATE = 63, 2373, 2376
DATA_TYPES = {
    ValueType.BOOLEAN: 1,
    ValueType.BYTE: 3,
    ValueType.UINT32: 7,
    ValueType.INT64: 8,
    ValueType.DOUBLE: 11,
    STRING: 12,
}
"""OPC UA built-in types by name (OPC 10000-6, table 1)."""


@dataclass(frozen=True, slots=True)
class Folder:
    """A folder; `path` is its node id, `parent` that of the folder it is in."""

    path: str
    parent: str
    name: str
    description: str = ""


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable with the properties that its type definition requires."""

    path: str  # node id and, for signals, name in the signal table
    parent: str
    name: str
    description: str
    # numeric node ids in namespace 0
    type_definition: int
    data_type: int
    writable: bool
    length: int | None = None  # number of elements of an array, None for a scalar
    eu_range: tuple[float, float] | None = None  # lowest and highest value
    unit: Unit | None = None
    enum_strings: tuple[str, ...] = ()
    two_states: tuple[str, ...] = ()


def split(path: str) -> tuple[str, str]:
    """Return the folder and the last part of a dotted name."""
    parent, _, name = path.rpartition(".")
    return parent or ROBOT, name


def folders_of(paths: Iterable[str]) -> Iterator[Folder]:
    """Yield every folder of `paths`, each after its parent."""
    seen: set[str] = set()
    for path in paths:
        parts = path.split(".")[:-1]
        for depth in range(1, len(parts) + 1):
            folder = ".".join(parts[:depth])
            if folder not in seen:
                seen.add(folder)
                parent, name = split(folder)
                yield Folder(folder, parent, name, GROUPS.get(folder, ""))


def variable_of(signal: Signal) -> Variable:
    """Return the variable that shows `signal`."""
    parent, name = split(signal.name)
    has_unit = signal.unit != "1"
    is_ranged = math.isfinite(signal.low) and math.isfinite(signal.high)
    is_boolean = signal.type is ValueType.BOOLEAN
    type_definition = BASE_DATA_VARIABLE
    if signal.labels:
        type_definition = TWO_STATE if is_boolean else MULTI_STATE
    elif is_boolean:
        pass
    elif has_unit:
        type_definition = ANALOG_UNIT_RANGE if is_ranged else ANALOG_UNIT
    elif is_ranged:
        type_definition = ANALOG_ITEM
    is_analog = type_definition in (ANALOG_ITEM, ANALOG_UNIT, ANALOG_UNIT_RANGE)
    length = len(signal.slots) if signal.is_array else None
    eu_range = (signal.low, signal.high) if is_analog and is_ranged else None
    found_unit = find_unit(signal.unit) if has_unit else None
    return Variable(
        path=signal.name,
        parent=parent,
        name=name,
        description=signal.description,
        type_definition=type_definition,
        data_type=DATA_TYPES[signal.type],
        writable=signal.writable,
        length=length,
        eu_range=eu_range,
        unit=found_unit,
        enum_strings=() if is_boolean else signal.labels,
        two_states=signal.labels if is_boolean else (),
    )


def _of_parameter(parameter: "Parameter") -> Variable:
    """Return the variable that shows a parameter; all of them have a range and a unit."""
    path = PARAMETERS + parameter.name
    parent, name = split(path)
    text = parameter.meaning + ("; NaN is null" if parameter.nullable else "")
    text += (
        f"; SetParameter takes it {parameter.names_text}"
        if parameter.names_text
        else ""
    )
    description = text + (
        "; a change needs a restart" if parameter.when == "restart" else ""
    )
    found_unit = UNECE.get(parameter.unit) or Unit(
        parameter.unit, "", -1, parameter.unit
    )
    return Variable(
        path=path,
        parent=parent,
        name=name,
        description=description,
        type_definition=ANALOG_UNIT_RANGE,
        data_type=DATA_TYPES[ValueType.DOUBLE],
        writable=True,
        eu_range=(parameter.low, parameter.high),
        unit=found_unit,
    )


def describe(
    table: SignalTable, parameters: "Iterable[Parameter]" = ()
) -> tuple[list[Folder], list[Variable]]:
    """Return all folders and variables of a signal table, and of parameters.

    ConfigError if a signal (of an own block) has the name of a folder, or an unknown unit.
    """
    variables = [variable_of(signal) for signal in table]
    variables.append(
        Variable(
            path=CONTROL_SOURCE,
            parent="control",
            name="source",
            description="Kind of source that has control: write 'opcua' to take it",
            type_definition=BASE_DATA_VARIABLE,
            data_type=DATA_TYPES[STRING],
            writable=True,
        )
    )
    paths = [variable.path for variable in variables]
    own = [_of_parameter(parameter) for parameter in parameters]
    places = [
        *(f"{group}.x" for group in GROUPS),
        *paths,
        *(variable.path for variable in own),
    ]
    folders = list(folders_of(places))
    taken = {folder.path for folder in folders} | {ROBOT}
    for path in paths:
        if path in taken or path.split(".")[0] in {ROBOT, *GROUPS}:
            raise ConfigError(
                f"a signal cannot be called '{path}': the address space uses the name"
            )
    return folders, variables + own

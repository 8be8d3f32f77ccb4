"""Figures about the daemon itself: slices, peers, audit; variables are made when first seen.

A provider returns one plain table, ``{"plant": {"overruns": 0, ...}, ...}``; its entry becomes the
variable ``slices.plant.overruns``. A figure that is None has no value yet
(BadWaitingForInitialData).
"""

import time
from datetime import UTC, datetime
from typing import Any

from asyncua import ua

from hilserver.io.opcua_server import model
from hilserver.io.opcua_server.address_space import AddressSpaceBuilder
from hilserver.io.world import Figure, Provider, Table
from hilserver.opcua.encoding import FixedDataValue
from hilserver.opcua.logs import log

_MAX_VARIABLES = 2000
_WAITING = ua.StatusCode(ua.StatusCodes.BadWaitingForInitialData)
_NO_VALUE = ua.Variant()
_TYPES: dict[type, ua.VariantType] = {
    bool: ua.VariantType.Boolean,
    int: ua.VariantType.Int64,
    float: ua.VariantType.Double,
    str: ua.VariantType.String,
}
_NEVER = object()


class Diagnostics:
    """Variables of one group, written when their figure changes.

    Parameters
    ----------
    group : str
        Folder, one of `model.GROUPS`.
    flat : str or None
        Figure that represents its entry: ``audit.<item>`` shows the figure "ok", with the other
        figures below it.
    every_s : float
        Shortest time between two calls of the provider [s].
    """

    def __init__(
        self,
        builder: AddressSpaceBuilder,
        group: str,
        provider: Provider,
        flat: str | None = None,
        every_s: float = 0.0,
    ) -> None:
        self._builder = builder
        self._group = group
        self._provider = provider
        self._flat = flat
        self._folders: set[str] = {group}
        self._places: dict[str, Any] = {}
        self._types: dict[str, ua.VariantType] = {}
        self._last: dict[str, object] = {}
        self._is_full = False
        self._every_s = every_s
        self._due_s = 0.0
        self._table: Table = {}

    def publish(self) -> Table:
        """Call the provider if that is due, write what has changed, and return the table."""
        now_s = time.monotonic()
        if now_s < self._due_s:
            return self._table
        self._due_s, self._table = now_s + self._every_s, self._provider()
        for entry, figures in self._table.items():
            name = entry.replace(".", "_")
            for figure, value in sorted(
                figures.items(), key=lambda row: row[0] != self._flat
            ):
                path = f"{self._group}.{name}"
                place = path if figure == self._flat else f"{path}.{figure}"
                self._show(place, value)
        return self._table

    def _show(self, path: str, value: Figure) -> None:
        is_equal = self._last.get(path, _NEVER) == value
        if is_equal and type(self._last[path]) is type(value):
            return
        if path not in self._places and not self._add(path, value):
            return
        self._last[path] = value
        kind = self._types[path]
        converted: (
            object  # in the type of its variable, None if it has no value in that type
        )
        if value is None:
            converted = None
        elif kind is ua.VariantType.String:
            converted = str(value)
        elif isinstance(value, str):
            converted = None
        elif kind is ua.VariantType.Double:
            converted = float(value)
        elif kind is ua.VariantType.Boolean:
            converted = bool(value)
        else:
            converted = int(value) if abs(value) < 2**63 else None  # also None for NaN
        if converted is None:
            now = datetime.now(UTC)
            self._places[path].value = FixedDataValue(_NO_VALUE, _WAITING, now, now)
        else:
            self._places[path].value = FixedDataValue.good(
                converted, kind, is_array=False
            )

    def _add(self, path: str, value: Figure) -> bool:
        if len(self._places) >= _MAX_VARIABLES:
            if not self._is_full:
                log.warning(
                    "too many figures for OPC UA",
                    group=self._group,
                    shown=_MAX_VARIABLES,
                )
            self._is_full = True
            return False
        kind = _kind_of(path, value)
        parent, name = model.split(path)
        if parent not in self._places and parent not in self._folders:
            grandparent, folder = model.split(parent)
            self._builder.folders([model.Folder(parent, grandparent, folder)])
            self._folders.add(parent)
        variable = model.Variable(
            path,
            parent,
            name,
            "",
            model.BASE_DATA_VARIABLE,
            kind.value,
            writable=False,
        )
        self._builder.variable(variable)
        self._places[path] = self._builder.value_of(self._builder.node_id(path))
        self._types[path] = kind
        return True


def _kind_of(path: str, value: Figure) -> ua.VariantType:
    """Return the type of a figure's variable; one without a value yet will be a number or tick."""
    for python_type, kind in _TYPES.items():
        if isinstance(value, python_type):
            return kind
    return ua.VariantType.Int64 if path.endswith("_tick") else ua.VariantType.Double

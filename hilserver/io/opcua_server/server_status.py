"""ServerStatus and ServiceLevel: what a client reads before it trusts the rest.

ServerState: Running while the plant runs or is in its safe state, Suspended while it starts or is
paused (values do not change), Shutdown at the end.

ServiceLevel (OPC 10000-4, 6.6.2): 255 running; 240 running, but the real-time audit misses
something; 199 a configured peer is away; 150 paused; 100 safe state; 1 starting; 0 stopping.
"""

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from asyncua import ua

import hilserver
from hilserver.opcua.encoding import FixedDataValue
from hilserver.signals import State

PRODUCT_URI = "urn:hilserver"

_SERVER_STATES = {
    State.STARTING: ua.ServerState.Suspended,
    State.RUNNING: ua.ServerState.Running,
    State.PAUSED: ua.ServerState.Suspended,
    State.SAFE: ua.ServerState.Running,
    State.STOPPING: ua.ServerState.Shutdown,
}
_LEVELS = {State.STARTING: 1, State.PAUSED: 150, State.SAFE: 100, State.STOPPING: 0}
_LEVEL_FULL, _LEVEL_AUDIT, _LEVEL_PEER = 255, 240, 199


class ServerStatus:
    """Keeps state and service level of the Server object up to date."""

    def __init__(self, address_space: Any) -> None:
        kinds = ua.ObjectIds
        self._status = _place(address_space, kinds.Server_ServerStatus)
        self._state = _place(address_space, kinds.Server_ServerStatus_State)
        self._level = _place(address_space, kinds.Server_ServiceLevel)
        self._shown: tuple[State, int] | None = None

    def show(self, state: State, peers: Mapping[str, Any], audit: Mapping[str, Any]) -> None:
        """Write state and service level where they changed."""
        level = service_level(state, peers, audit)
        if self._shown == (state, level):
            return
        self._shown = (state, level)
        now = datetime.now(UTC)
        server_state = _SERVER_STATES[state]
        old = self._status.value.Value.Value
        status = ua.ServerStatusDataType(
            StartTime=old.StartTime,
            CurrentTime=now,
            State=server_state,
            BuildInfo=old.BuildInfo,
            SecondsTillShutdown=old.SecondsTillShutdown,
            ShutdownReason=old.ShutdownReason,
        )
        self._status.value = FixedDataValue.good(status, ua.VariantType.ExtensionObject)
        self._state.value = FixedDataValue.good(server_state, ua.VariantType.Int32)
        self._level.value = FixedDataValue.good(level, ua.VariantType.Byte)


def service_level(state: State, peers: Mapping[str, Any], audit: Mapping[str, Any]) -> int:
    """Return the ServiceLevel that goes with a state."""
    if state is not State.RUNNING:
        return _LEVELS[state]
    if any(figures.get("connected") is False for figures in peers.values()):
        return _LEVEL_PEER
    if any(figures.get("ok") is False for figures in audit.values()):
        return _LEVEL_AUDIT
    return _LEVEL_FULL


def build_info() -> dict[str, Any]:
    """Return the arguments of asyncua's `set_build_info`."""
    built = datetime.fromtimestamp(Path(hilserver.__file__).stat().st_mtime, UTC)
    return {
        "product_uri": PRODUCT_URI,
        "manufacturer_name": "hilserver",
        "product_name": "hilserver",
        "software_version": hilserver.__version__,
        "build_number": hilserver.__version__,
        "build_date": built,
    }


def _place(address_space: Any, identifier: int) -> Any:
    return address_space[ua.NodeId(identifier)].attributes[ua.AttributeIds.Value]

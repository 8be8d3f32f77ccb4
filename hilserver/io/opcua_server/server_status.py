"""ServerStatus, ServiceLevel and nameplate: what a client reads before it trusts the rest.

ServerState: Running while the plant runs or is in its safe state, Suspended while it starts or is
paused (values do not change), Shutdown at the end.

ServiceLevel (OPC 10000-4, 6.6.2): 255 running; 240 running, but the real-time audit misses
something; 199 a configured peer is away; 150 paused; 100 safe state; 1 starting; 0 stopping.

The nameplate identifies the robot as a device (OPC 10000-100, 4.5.2): asset tools look for it in
the namespace of DI, at the device itself and in its group Identification.
"""

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from asyncua import ua

import hilserver
from hilserver import __version__
from hilserver.compiled.cache import kernel_hash
from hilserver.config.root import Config
from hilserver.opcua.encoding import FixedDataValue
from hilserver.signals import State

GROUP = "Identification"
STRING, LOCALIZED_TEXT, INT32 = 12, 21, 6


class Entry(NamedTuple):
    """A property of the nameplate; `kind` is the identifier of its data type."""

    name: str
    value: Any
    kind: int = STRING


def nameplate(config: Config, application_uri: str) -> tuple[Entry, ...]:
    """Return the nameplate of the configured robot.

    The serial number is the beginning of the configuration's hash: same number, same robot. The
    revision of the device is that of its compiled equations.
    """
    serial = config.sha256[:12]
    return (
        Entry("Manufacturer", "hilserver", LOCALIZED_TEXT),
        Entry("ManufacturerUri", "urn:hilserver"),
        Entry("Model", "Simulated four-wheeled robot", LOCALIZED_TEXT),
        Entry("ProductCode", "hilserver-robot"),
        Entry("HardwareRevision", "simulated"),
        Entry("SoftwareRevision", __version__),
        Entry("DeviceRevision", kernel_hash()),
        Entry("DeviceClass", "Mobile robot"),
        Entry("DeviceManual", "docs/index.md"),
        Entry("SerialNumber", serial),
        Entry("ProductInstanceUri", f"{application_uri}:{serial}"),
        Entry("RevisionCounter", -1, INT32),  # -1: not counted
    )


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

    def show(
        self, state: State, peers: Mapping[str, Any], audit: Mapping[str, Any]
    ) -> None:
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


def service_level(
    state: State, peers: Mapping[str, Any], audit: Mapping[str, Any]
) -> int:
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

"""The OPC UA server as the daemon sees it."""

import errno
import os
import socket
from datetime import UTC, datetime

from asyncua import ua

from hilserver.clock import UtcClock
from hilserver.config.server import OpcUaConfig
from hilserver.control import Control, State
from hilserver.errors import FailedError
from hilserver.events import EventBus
from hilserver.image import Frame, ProcessImage
from hilserver.inputs import InputGate
from hilserver.io.opcua_server import model
from hilserver.io.opcua_server.access import Access
from hilserver.io.opcua_server.address_space import AddressSpaceBuilder
from hilserver.io.opcua_server.diagnostics import Diagnostics, Figure, Provider, Table
from hilserver.io.opcua_server.door import WriteDoor
from hilserver.io.opcua_server.guard import RobotInternalServer
from hilserver.io.opcua_server.logs import log
from hilserver.io.opcua_server.method_table import METHODS
from hilserver.io.opcua_server.methods import Methods
from hilserver.io.opcua_server.robot_events import RobotEvents
from hilserver.io.opcua_server.server_status import PRODUCT_URI, ServerStatus, build_info
from hilserver.io.opcua_server.transport import RobotUaServer
from hilserver.io.opcua_server.values import FixedDataValue, SignalVariables, write_value
from hilserver.signals import SignalTable

_GOOD = ua.StatusCode(ua.StatusCodes.Good)


def _nothing() -> Table:
    return {}


class OpcUaServer:
    """Shows the process image over OPC UA and lets clients write inputs and call methods.

    Everything but `start` and `stop` is synchronous, does not wait and belongs to the event loop's
    thread; the plant never notices.

    Parameters
    ----------
    statistics, peers, audit : callable
        Return plain tables, ``{name: {figure: number, text, Boolean or None}}``. Rows of `peers`
        have the figure "connected", rows of `audit` "ok"; both act on ServiceLevel.
    access : Access
        Decides who may do what.

    Raises
    ------
    ConfigError
        If a signal's name or unit cannot be shown.
    """

    def __init__(
        self,
        config: OpcUaConfig,
        table: SignalTable,
        image: ProcessImage,
        gate: InputGate,
        control: Control,
        events: EventBus,
        clock: UtcClock,
        *,
        statistics: Provider = _nothing,
        peers: Provider = _nothing,
        audit: Provider = _nothing,
        access: Access | None = None,
    ) -> None:
        self._config = config
        self._table = table
        self._image = image
        self._gate = gate
        self._control = control
        self._events = events
        self._clock = clock
        self._providers: dict[str, Provider] = {
            "slices": statistics,
            "peers": peers,
            "audit": lambda: {**audit(), **self.audit()},
        }
        self._folders, self._rows = model.describe(table)
        self._access = access or Access()
        self._server: RobotUaServer | None = None
        self._owner_shown = ""

    @property
    def url(self) -> str:
        """Endpoint with the port that was bound."""
        port = self._config.port
        if self._server is not None and self._server.bserver is not None:
            port = self._server.bserver.port
        host = f"[{self._config.host}]" if ":" in self._config.host else self._config.host
        _, _, path = self._config.endpoint.removeprefix("opc.tcp://").partition("/")
        return f"opc.tcp://{host}:{port}/{path}"

    @property
    def session_count(self) -> int:
        """Number of sessions of clients."""
        return 0 if self._server is None else len(self._server.iserver._external_sessions)

    def audit(self) -> dict[str, dict[str, Figure]]:
        """Return what this server has to say in the audit."""
        is_open = self._config.is_open_to_network
        return {
            "opcua_access": {
                "ok": not is_open,
                "found": f"{self._config.host}, no password",
                "wanted": "loopback only",
                "mend": "let opcua.endpoint listen on 127.0.0.1" if is_open else "",
            },
            "opcua_time_stamps": {
                "ok": True,
                "found": "simulated time" if self._clock.simulated else "UTC",
            },
        }

    async def start(self) -> None:
        """Build the address space and listen.

        Raises
        ------
        FailedError
            If the address cannot be listened on.
        """
        iserver = RobotInternalServer(self._config, self._access)
        server = RobotUaServer(iserver=iserver)
        await self._name_server(server)
        await self._build(server)
        try:
            await server.start()
        except OSError as error:
            await iserver.stop()
            raise FailedError(self._why_not(error)) from None
        self._server = server
        self._robot_events.attach(self._events)
        self.publish_diagnostics()
        if self._config.is_open_to_network:
            log.warning("opcua open to the network: anyone may command", endpoint=self.url)
        log.info("opcua server listens", endpoint=self.url)

    async def stop(self) -> None:
        """End all sessions and close the socket."""
        if self._server is None:
            return
        server, self._server = self._server, None
        self._robot_events.detach()
        self._status.show(State.STOPPING, {}, {})
        await server.stop()

    def publish(self, frame: Frame) -> int:
        """Write what changed in `frame`; called by the publish slice. Return how many variables."""
        if self._server is None:
            return 0
        self._show_owner()
        return self._variables.publish(frame)

    def publish_diagnostics(self) -> None:
        """Write slices, peers, audit and server status; called by the supervise slice."""
        if self._server is None:
            return
        self._show_owner()
        tables = {group: shown.publish() for group, shown in self._diagnostics.items()}
        self._status.show(self._control.state, tables["peers"], tables["audit"])
        self._robot_events.flush()

    async def _name_server(self, server: RobotUaServer) -> None:
        server.set_endpoint(self._config.endpoint)
        server.set_server_name("hilserver")
        server.product_uri = PRODUCT_URI
        server.manufacturer_name = "hilserver"
        server.application_type = ua.ApplicationType.Server
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        await server.init()
        uri = self._config.application_uri or f"urn:{socket.gethostname()}:hilserver"
        await server.set_application_uri(uri)
        await server.set_build_info(**build_info())

    async def _build(self, server: RobotUaServer) -> None:
        iserver = server.iserver
        robot_index = await server.register_namespace(model.NAMESPACE_URI)
        di_index = await server.register_namespace(model.DI_NAMESPACE_URI)
        builder = AddressSpaceBuilder(iserver.node_mgt_service, robot_index, di_index)
        builder.roots()
        builder.folders(self._folders)
        for row in self._rows:
            builder.variable(row)
        for method in METHODS:
            builder.method(method)

        def place(path: str) -> object:
            return builder.value_of(builder.node_id(path))

        places = {signal.name: place(signal.name) for signal in self._table}
        self._variables = SignalVariables(self._table, places, self._clock)
        self._owner_place = place(model.CONTROL_SOURCE)
        self._owner_shown = ""
        self._diagnostics = {
            group: Diagnostics(builder, group, provider, flat="ok" if group == "audit" else None)
            for group, provider in self._providers.items()
        }
        self._robot_events = RobotEvents(
            builder,
            iserver.subscription_service,
            self._clock,
            limit_per_s=self._config.max_events_per_s,
        )
        self._status = ServerStatus(iserver.aspace)
        iserver.methods = Methods(self._control, self._access, builder.node_id)
        iserver.door = WriteDoor(
            iserver.aspace,
            robot_index,
            self._table,
            self._image,
            self._gate,
            self._variables,
            self._access,
        )

    def _show_owner(self) -> None:
        if self._gate.owner == self._owner_shown:
            return
        self._owner_shown = self._gate.owner
        now = datetime.now(UTC)
        owner = ua.Variant(self._owner_shown, ua.VariantType.String)
        write_value(self._owner_place, FixedDataValue(owner, _GOOD, now, now))

    def _why_not(self, error: OSError) -> str:
        what = f"OPC UA cannot listen on {self._config.host}:{self._config.port}"
        if error.errno == errno.EADDRINUSE:
            return f"{what}: the port is in use; end the other program or change opcua.endpoint"
        if error.errno == errno.EACCES:
            return f"{what}: ports below 1024 need rights; change opcua.endpoint"
        return f"{what}: {error.strerror or os.strerror(error.errno or 0)}; change opcua.endpoint"

"""The OPC UA server as a part of the daemon."""

from collections.abc import Iterator
from typing import Any

from asyncua import ua

from hilserver.image import Frame
from hilserver.io.opcua_server import model
from hilserver.io.opcua_server.address_space import AddressSpaceBuilder
from hilserver.io.opcua_server.application import RobotApplication
from hilserver.io.opcua_server.diagnostics import Diagnostics
from hilserver.io.opcua_server.method_table import METHODS, Parts
from hilserver.io.opcua_server.parameters import ParameterVariables
from hilserver.io.opcua_server.robot_events import RobotEvents
from hilserver.io.opcua_server.server_status import (
    PRODUCT_URI,
    ServerStatus,
    build_info,
    nameplate,
)
from hilserver.io.opcua_server.values import SignalVariables
from hilserver.io.world import Figure, Part, World
from hilserver.opcua.encoding import FixedDataValue
from hilserver.opcua.logs import log
from hilserver.opcua.server import HardenedServer, application_uri
from hilserver.opcua.settings import Role
from hilserver.signals import State

_SLICES_EVERY_S = 1.0  # they change every time, and they are many


class OpcUaServer(Part):
    """Shows the process image over OPC UA and lets clients write inputs and call methods.

    Everything except `start` and `stop` is synchronous, does not wait and is for the thread of the
    event loop; the plant is not affected. ConfigError if a signal's name or unit cannot be shown.
    """

    section, label, is_early = "opcua", "OPC UA", True

    def __init__(self, world: World) -> None:
        self._world = world
        self._config = world.config.opcua
        self._gate = world.gate
        audit = world.tables["audit"]
        self._providers = dict(world.tables) | {
            "audit": lambda: {**audit(), **self.audit()}
        }
        if world.faults is not None:
            self._providers["faults"] = world.faults.figures
        parameters = () if world.parameters is None else world.parameters.table.values()
        self._folders, self._rows = model.describe(world.table, parameters)
        self._server: HardenedServer | None = None
        self._owner_shown = ""

    @property
    def url(self) -> str:
        """Endpoint with the port that was bound."""
        return str(self._config.endpoint if self._server is None else self._server.url)

    address = url

    @property
    def page_secret(self) -> str:
        """Secret that marks sessions of the operator page; empty while the server does not run."""
        return "" if self._server is None else self._application.page_secret

    def audit(self) -> dict[str, dict[str, Figure]]:
        """Return the audit of this server."""
        config = self._config
        is_open = config.is_open_to_network and not (
            config.is_secure and config.anonymous_role in (None, Role.OBSERVER)
        )
        protection = "certificates" if config.is_secure else "policy None"
        if config.anonymous_role is None:
            who = "users"
        else:
            who = f"{config.anonymous_role.name.lower()}"
        open_to: dict[str, Figure] = {
            "ok": not is_open,
            "found": f"{config.host}, {protection}, open to {who}",
            "wanted": "loopback, or certificates and users",
            "remedy": "see docs/how-to/secure-the-server.md" if is_open else "",
        }
        stamps: dict[str, Figure] = {
            "ok": True,
            "found": "simulated time" if self._world.clock.simulated else "UTC",
        }
        return {
            "opcua_access": open_to,
            "opcua_time_stamps": stamps,
        }

    async def start(self) -> None:
        """Build the address space and listen.

        FailedError if the address cannot be listened on; ConfigError if certificate or key are
        missing or cannot be used.
        """
        server = HardenedServer(
            self._config, self._world.folder, self._world.tasks.spawn
        )
        server.set_server_name("hilserver")
        server.product_uri = PRODUCT_URI
        server.manufacturer_name = "hilserver"
        await server.init()
        await server.set_build_info(**build_info())
        await self._build(server)
        await server.start()
        self._server = server
        self._robot_events.attach(self._world.events)
        self.publish_diagnostics()
        if not self.audit()["opcua_access"]["ok"]:
            log.warning(
                "opcua is open to the network: anyone may command", endpoint=self.url
            )
        log.info("opcua server listens", endpoint=self.url)

    async def stop(self) -> None:
        """End all sessions and close the socket."""
        if self._server is None:
            return
        server = self._server
        self._server = None
        self._robot_events.detach()
        self._status.show(State.STOPPING, {}, {})
        await server.stop()

    def publish(self, frame: Frame) -> int:
        """Show `frame`; called by the publish slice. Return the number of changed slots."""
        if self._server is None:
            return 0
        self._show_owner()
        changed = self._variables.publish(frame)
        self._parameters.publish()
        self._server.sample()
        return changed

    def publish_diagnostics(self) -> None:
        """Write slices, peers, audit and server status; called by the supervise slice."""
        if self._server is None:
            return
        self._show_owner()
        tables = {group: shown.publish() for group, shown in self._diagnostics.items()}
        self._status.show(self._world.control.state, tables["peers"], tables["audit"])
        self._robot_events.flush()

    supervise = publish_diagnostics

    def _tables(self, builder: AddressSpaceBuilder) -> dict[str, Diagnostics]:
        return {
            group: Diagnostics(
                builder,
                group,
                provider,
                flat="ok" if group == "audit" else None,
                every_s=_SLICES_EVERY_S if group == "slices" else 0.0,
            )
            for group, provider in self._providers.items()
        }

    async def _build(self, server: HardenedServer) -> None:
        iserver = server.iserver
        world = self._world
        robot_index = await server.register_namespace(model.NAMESPACE_URI)
        di_index = await server.register_namespace(model.DI_NAMESPACE_URI)
        builder = AddressSpaceBuilder(iserver.node_mgt_service, robot_index, di_index)
        builder.roots()
        builder.namespaces()
        builder.nameplate(nameplate(world.config, application_uri(self._config)))
        builder.folders(self._folders)
        for row in self._rows:
            builder.variable(row)
        for method in METHODS:
            builder.method(method)

        def place(path: str) -> Any:
            return builder.value_of(builder.node_id(path))

        self._variables = SignalVariables(world.table, world.clock)
        for name, signal_place in self._variables.places.items():
            builder.set_place(builder.node_id(name), signal_place)
        self._parameters = ParameterVariables(world.parameters, place)
        self._owner_place = place(model.CONTROL_SOURCE)
        self._diagnostics = self._tables(builder)
        self._robot_events = RobotEvents(
            builder,
            iserver.subscription_service,
            world.clock,
            limit_per_s=self._config.max_events_per_s,
        )
        self._status = ServerStatus(iserver.aspace)
        self._application = server.application = RobotApplication(
            iserver,
            robot_index,
            world.table,
            world.image,
            self._gate,
            self._variables,
            self._parameters,
            Parts(world.control, world.faults, world.files),
            self._show_owner,
        )

    def _show_owner(self) -> None:
        if self._gate.owner == self._owner_shown:
            return
        self._owner_shown = self._gate.owner
        self._owner_place.value = FixedDataValue.good(
            self._owner_shown, ua.VariantType.String
        )


def parts(world: World) -> Iterator[OpcUaServer]:
    """Yield the server, if the configuration has one."""
    if not world.config.opcua.enabled:
        return
    with world.at("blocks"):  # for a block's name or unit that cannot be shown
        yield OpcUaServer(world)

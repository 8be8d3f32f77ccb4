"""The controller's address space: the same nodes as the Node-RED flow in deploy/node-red."""

import logging
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from urllib.parse import urlsplit

from asyncua import Server, ua

from hilserver.controller.nodes import NAMESPACE, SENSORS, SEQUENCE, SETPOINTS
from hilserver.errors import FailedError
from hilserver.opcua.standard_nodes import QuickInternalServer
from hilserver.program.children import free_port

TYPES = {"enable": ua.VariantType.Boolean, SEQUENCE: ua.VariantType.UInt32}
"""Every other node is a Double."""

PORT_ATTEMPTS = 5
_CURRENT_TIME = ua.NodeId(ua.ObjectIds.Server_ServerStatus_CurrentTime)


class ControllerServer:
    """Offers set-points and takes sensor values; an async context manager.

    Parameters
    ----------
    endpoint : str
        ``opc.tcp://127.0.0.1:<port>/UA/NodeRedAgv``; port 0: any free one.
    more_sensors : sequence of str
        Nodes that clients may write in addition to `SENSORS`.
    """

    def __init__(self, endpoint: str, *, more_sensors: Sequence[str] = ()) -> None:
        logging.getLogger("asyncua.server").setLevel(logging.CRITICAL + 1)
        self.endpoint = endpoint  # where it listens
        self._sensors = (*SENSORS, *more_sensors)
        self._server = Server(iserver=QuickInternalServer())
        self._ids: dict[str, ua.NodeId] = {}

    async def __aenter__(self) -> "ControllerServer":
        await self._server.init()
        self._server.set_server_name("hilserver embedded controller")
        self._server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        namespace = await self._server.register_namespace(NAMESPACE)
        folder = ua.NodeId("agv", namespace)
        agv = await self._server.nodes.objects.add_folder(folder, "agv")
        for name in (*SETPOINTS, SEQUENCE, *self._sensors):
            kind = TYPES.get(name, ua.VariantType.Double)
            initial = ua.Variant(False if kind is ua.VariantType.Boolean else 0, kind)
            node = await agv.add_variable(ua.NodeId(name, namespace), name, initial)
            if name in self._sensors:
                await node.set_writable()
            self._ids[name] = node.nodeid
        await self._listen()
        return self

    async def _listen(self) -> None:
        wanted = urlsplit(self.endpoint)
        for attempt in range(PORT_ATTEMPTS):
            port = wanted.port or free_port(wanted.hostname or "127.0.0.1")
            self.endpoint = f"opc.tcp://{wanted.hostname}:{port}{wanted.path}"
            self._server.set_endpoint(self.endpoint)
            try:
                await self._server.start()
            except OSError as error:
                # Another program may take a free port before we listen on it.
                if not wanted.port and attempt < PORT_ATTEMPTS - 1:
                    continue
                reason = error.strerror or str(error)
                raise FailedError(f"port {port} cannot be used: {reason}") from error
            return

    async def __aexit__(self, *_: object) -> None:
        await self._server.stop()

    async def offer(self, values: Mapping[str, object], at: datetime) -> None:
        """Serve one set of set-points with one SourceTimestamp; `seq` last if it is among them."""
        for name in sorted(values, key=lambda name: name == SEQUENCE):
            value = ua.Variant(values[name], TYPES.get(name, ua.VariantType.Double))
            data = ua.DataValue(value, SourceTimestamp=at, ServerTimestamp=at)
            await self._server.write_attribute_value(self._ids[name], data)
        # asyncua updates CurrentTime once a second, too coarse for comparing clocks.
        now = ua.DataValue(ua.Variant(datetime.now(UTC), ua.VariantType.DateTime))
        await self._server.write_attribute_value(_CURRENT_TIME, now)

    def read(self, name: str) -> tuple[object, datetime | None]:
        """Return the newest value and SourceTimestamp that a client wrote to `name`."""
        data = self._server.iserver.aspace.read_attribute_value(
            self._ids[name], ua.AttributeIds.Value
        )
        usable = data.StatusCode is None or not data.StatusCode.is_bad()
        return (
            data.Value.Value if usable and data.Value else None
        ), data.SourceTimestamp

    def watch(self, name: str, callback: Callable[[object], None]) -> None:
        """Call `callback` with every value that a client writes to `name`."""

        async def on_change(
            _handle: int, data: ua.DataValue, _error: object = None
        ) -> None:
            callback(data.Value.Value if data.Value else None)

        self._server.iserver.aspace.add_datachange_callback(
            self._ids[name], ua.AttributeIds.Value, on_change
        )

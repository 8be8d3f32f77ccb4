"""The socket side of the server: our processor per connection, with words to refused operations.

A client that asks for diagnostics (ReturnDiagnostics of the request header) gets a sentence beside
the status code of every refused write and call.
"""

from collections.abc import Sequence
from typing import Any

from asyncua import Server, ua
from asyncua.server.binary_server_asyncio import BinaryServer, OPCUAProtocol
from asyncua.server.uaprocessor import UaProcessor

from hilserver.io.opcua_server.logs import log

_MAX_UNREAD_BYTES = 8 * 1024 * 1024
_OPERATION_TEXT, _OPERATION_ADDITIONAL_INFO = 0x40, 0x80
"""Bits of ReturnDiagnostics (OPC 10000-4, RequestHeader)."""


class RobotProcessor(UaProcessor):  # type: ignore[misc]
    """Processes the messages of one connection, one after the other."""

    _wanted = 0

    async def _process_message(self, typeid: Any, requesthdr: Any, seqhdr: Any, body: Any) -> Any:
        self._wanted = requesthdr.ReturnDiagnostics
        return await super()._process_message(typeid, requesthdr, seqhdr, body)

    def send_response(self, requesthandle: Any, seqhdr: Any, response: Any, *more: Any) -> None:
        """Send a response, with diagnostics where the client asked for them."""
        if self._transport.is_closing():
            return  # uvloop raises on a write to a closed connection
        if self._transport.get_write_buffer_size() > _MAX_UNREAD_BYTES:
            log.warning("opcua client does not read its answers: closed", client=str(self.name))
            self._transport.abort()
            return
        if isinstance(response, ua.WriteResponse | ua.CallResponse) and self.session is not None:
            explain(response, self.session.texts, self._wanted)
        super().send_response(requesthandle, seqhdr, response, *more)


def explain(response: Any, texts: Sequence[str], wanted: int) -> None:
    """Add the sentences that a client asked for to a Write or Call response."""
    if not any(texts) or not wanted & (_OPERATION_TEXT | _OPERATION_ADDITIONAL_INFO):
        return
    table: list[str] = []
    for text in texts:
        info = ua.DiagnosticInfo()
        if text and wanted & _OPERATION_ADDITIONAL_INFO:
            info.AdditionalInfo = text
        if text and wanted & _OPERATION_TEXT:
            info.LocalizedText = len(table)
            table.append(text)
        response.DiagnosticInfos.append(info)
    response.ResponseHeader.StringTable = table


class RobotProtocol(OPCUAProtocol):  # type: ignore[misc]
    """A connection whose messages go to a `RobotProcessor`."""

    processor: Any

    def connection_made(self, transport: Any) -> None:
        """Begin to serve a client."""
        super().connection_made(transport)
        if self.processor is not None:
            self.processor = RobotProcessor(self.iserver, transport, self.limits)
            self.processor.set_policies(self.policies)


class RobotBinaryServer(BinaryServer):  # type: ignore[misc]
    """The listening socket."""

    def _make_protocol(self) -> RobotProtocol:
        return RobotProtocol(
            iserver=self.iserver,
            policies=self._policies,
            clients=self.clients,
            closing_tasks=self.closing_tasks,
            limits=self.limits,
        )


class RobotUaServer(Server):  # type: ignore[misc]
    """asyncua's server on our socket side."""

    async def start(self) -> None:
        """Listen; OSError if the address cannot be had."""
        await self._setup_server_nodes()
        host, port = self._get_bind_socket_info()
        self.bserver = RobotBinaryServer(self.iserver, host, port, self.limits)
        self.bserver.set_policies(self._policies)
        await self.iserver.start()
        await self.bserver.start()

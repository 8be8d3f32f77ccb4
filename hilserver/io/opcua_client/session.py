"""One connection to a peer: open, find the nodes, read and judge; good until its first error.

Every attempt gets a new asyncua client, because one whose link went dead can hang in its own
reconnect; and every wait has a limit, because a dead link does not answer.
"""

import asyncio
import contextlib
import logging
from collections.abc import Callable, Iterable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

from asyncua import Client, ua

from hilserver.config.peers import NodeAddress
from hilserver.io.opcua_client.refusal import hung_up, refused_by_peer
from hilserver.io.opcua_client.security import LinkSecurity, PeerClient
from hilserver.io.peer_link import samples
from hilserver.io.peer_link.samples import (
    FaultKind,
    LinkLostError,
    LinkRefusedError,
    SampleVerdict,
)
from hilserver.time_limit import time_limit

CONNECT_TIMEOUT_S = 2.0  # for the TCP connection and for each request

OPEN_TIMEOUT_S = 6.0  # for connection, channel and session together
OPEN_AT_MOST_S = 60.0  # where a quota or other programs leave us little time for keys

CLOSE_TIMEOUT_S = 1.0
TRUST_EVERY_S = 5.0  # how often an open session checks that the peer is still trusted

SESSION_TIMEOUT_MS = 30_000  # how long the peer keeps a session that we could not close

_NAMESPACE_ARRAY = ua.NodeId(ua.ObjectIds.Server_NamespaceArray)
_CURRENT_TIME = ua.NodeId(ua.ObjectIds.Server_ServerStatus_CurrentTime)
_EPOCH, _MICROSECOND = datetime(1970, 1, 1, tzinfo=UTC), timedelta(microseconds=1)


RECEIVE_MAX = 16 * 1024 * 1024
"""Bytes of an incomplete message; the library would collect as many as its header announces."""


def quieten_asyncua() -> None:
    """Silence the client library, which logs tracebacks for every lost link; we log one line."""
    for name in ("asyncua.client", "asyncua.common", "asyncua.uaprotocol"):
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)


def read_request(
    nodes: Iterable[ua.NodeId], attribute: ua.AttributeIds
) -> ua.ReadParameters:
    """Build a multi-read that can be sent repeatedly."""
    parameters = ua.ReadParameters()
    parameters.TimestampsToReturn = ua.TimestampsToReturn.Source
    parameters.NodesToRead = [
        ua.ReadValueId(NodeId=n, AttributeId=attribute) for n in nodes
    ]
    return parameters


class PeerSession:
    """An open session; use it as an async context manager.

    Parameters
    ----------
    security : LinkSecurity or None
        Protects it; None: policy None and no user.
    """

    def __init__(self, endpoint: str, security: LinkSecurity | None = None) -> None:
        quieten_asyncua()
        self._endpoint = endpoint
        self._security = security
        self._client = PeerClient(
            endpoint, timeout=CONNECT_TIMEOUT_S, watchdog_intervall=3600
        )
        self._client.security = security
        self._client.name = "hilserver"
        self._client.application_uri = "urn:hilserver:client"
        self._client.session_timeout = SESSION_TIMEOUT_MS
        self._client.connection_lost_callback = self._on_lost
        self._client.uaclient._make_protocol = self._limited(
            self._client.uaclient._make_protocol
        )
        self._lost = asyncio.Event()
        # the raw services (read, write, create_subscription, ...)
        self.services: Any = self._client.uaclient.session

    async def __aenter__(self) -> "PeerSession":
        try:
            async with time_limit(OPEN_TIMEOUT_S, at_most_s=OPEN_AT_MOST_S):
                if self._security is not None:
                    await self._security.prepare(self._client, self._ask_endpoints)
                await self._client.connect()
                self._client.uaclient.protocol.timeout = CONNECT_TIMEOUT_S
        except (ua.UaStatusCodeError, ConnectionError) as error:
            await self._close(graceful=False)
            raise (self._refusal(error) or error) from None
        except BaseException:
            await self._close(graceful=False)
            raise
        return self

    def _refusal(self, error: Exception) -> LinkRefusedError | None:
        security = self._security
        ours = "" if security is None else security.thumbprint
        if isinstance(error, ua.UaStatusCodeError):
            return refused_by_peer(
                error, None if security is None else security.user, ours
            )
        is_protected = self._client.security_policy.Mode != ua.MessageSecurityMode.None_
        if is_protected and not isinstance(error, ConnectionRefusedError):
            return hung_up(ours)
        return None

    async def _ask_endpoints(self) -> list[ua.EndpointDescription]:
        """Ask on a separate connection without protection, as usual for discovery."""
        client = Client(self._endpoint, timeout=CONNECT_TIMEOUT_S)
        client.uaclient._make_protocol = self._limited(client.uaclient._make_protocol)
        try:
            endpoints: list[
                ua.EndpointDescription
            ] = await client.connect_and_get_server_endpoints()
        finally:
            protocol = client.uaclient.protocol
            if protocol is not None and protocol.transport is not None:
                protocol.transport.abort()
        return endpoints

    async def __aexit__(self, _kind: object, error: object, _trace: object) -> None:
        # If the task was cancelled, the link is intact: close the session properly.
        graceful = error is None or isinstance(error, asyncio.CancelledError)
        await self._close(graceful=graceful and not self._lost.is_set())

    @staticmethod
    def _limited(make_protocol: Callable[[], Any]) -> Callable[[], Any]:
        """Return a protocol factory whose protocols hang up on endless messages."""

        def make() -> Any:
            protocol = make_protocol()
            # until it is open: what limits that counts our time
            protocol.timeout = OPEN_AT_MOST_S
            receive = protocol.data_received

            def data_received(data: bytes) -> None:
                if len(protocol.receive_buffer or b"") + len(data) > RECEIVE_MAX:
                    protocol.receive_buffer = None
                    protocol.transport.abort()
                else:
                    receive(data)

            protocol.data_received = data_received
            return protocol

        return make

    async def _on_lost(self, _error: Exception) -> None:
        self._lost.set()

    async def watch_trust(self) -> None:
        """Never return; raise RefusedError when the peer is no longer trusted."""
        while True:
            await asyncio.sleep(TRUST_EVERY_S)
            if self._security is not None:
                self._security.check_again()

    async def wait_lost(self) -> None:
        """Never return; raise LinkLostError as soon as the transport is gone."""
        await self._lost.wait()
        raise LinkLostError("the peer closed the connection")

    async def _close(self, *, graceful: bool) -> None:
        protocol = self._client.uaclient.protocol
        transport = protocol.transport if protocol is not None else None
        if not graceful and transport is not None:
            transport.abort()
            await asyncio.sleep(0)  # lets the protocol see that its transport is gone
        with contextlib.suppress(Exception):
            async with time_limit(CLOSE_TIMEOUT_S):
                await self._client.disconnect()
        if transport is not None:
            transport.abort()

    async def read(self, request: ua.ReadParameters) -> list[ua.DataValue]:
        """Send one multi-read; one DataValue per node, in order."""
        values: list[ua.DataValue] = await self.services.read(request)
        if len(values) != len(request.NodesToRead):
            raise LinkLostError(
                "the peer answered a read with the wrong number of values"
            )
        return values

    async def read_attributes(
        self, nodes: list[ua.NodeId], attribute: ua.AttributeIds
    ) -> list[Any]:
        """Read one attribute of several nodes; None for a node that has none."""
        if not nodes:
            return []
        values = await self.read(read_request(nodes, attribute))
        return [
            v.Value.Value if v.StatusCode.is_good() and v.Value else None
            for v in values
        ]

    async def read_clock(self) -> Any:
        """Read the peer's ServerStatus.CurrentTime (datetime, or None)."""
        return (await self.read_attributes([_CURRENT_TIME], ua.AttributeIds.Value))[0]

    async def resolve(self, nodes: Iterable[str]) -> dict[str, ua.NodeId | None]:
        """Look up the namespaces and return the node ids; None if the URI is unknown."""
        uris = (await self.read_attributes([_NAMESPACE_ARRAY], ua.AttributeIds.Value))[
            0
        ] or []
        resolved: dict[str, ua.NodeId | None] = {}
        for text in nodes:
            address = NodeAddress.parse(text)
            index = address.namespace_index
            if address.namespace_uri in uris:
                index = uris.index(address.namespace_uri)
            resolved[text] = None
            if index is not None:
                resolved[text] = ua.NodeId.from_string(
                    f"ns={index};{address.identifier}"
                )
        return resolved


def utc_ns_of(stamp: datetime | None) -> int | None:
    """Return UTC [ns since 1970] of an OPC UA time stamp, if there is one."""
    if stamp is None:
        return None
    if stamp.tzinfo is None:
        stamp = stamp.replace(tzinfo=UTC)
    return (stamp - _EPOCH) // _MICROSECOND * 1000


def judge(sample: ua.DataValue) -> SampleVerdict:
    """Judge one sample; only status Good and finite numbers pass."""
    return replace(_judged(sample), stamp_ns=utc_ns_of(sample.SourceTimestamp))


def _judged(sample: ua.DataValue) -> SampleVerdict:
    status = sample.StatusCode
    if status is not None and not status.is_good():
        kind = FaultKind.BAD_STATUS
        if status.value in (
            ua.StatusCodes.BadNodeIdUnknown,
            ua.StatusCodes.BadNodeIdInvalid,
        ):
            kind = FaultKind.MISSING_NODE
        return SampleVerdict(fault=kind, detail=f"status {status.name}")
    value = sample.Value.Value if sample.Value is not None else None
    if value is None:
        return SampleVerdict(
            fault=FaultKind.NO_VALUE, detail="status Good without a value"
        )
    return samples.judge_value(value)

"""The socket side of the server: connections with deadlines, and the server that listens.

A connection that does not get on is closed: no Hello, no channel or an incomplete message after
`READ_DEADLINE_S`, no session after `LOGIN_DEADLINE_S`. When all places are taken, the one that has
waited longest without a session makes room.
"""

import asyncio
import contextlib
import time
from typing import Any

from asyncua import Server, ua
from asyncua.common.connection import TransportLimits
from asyncua.crypto.security_policies import (
    SECURITY_POLICY_TYPE_MAP,
    SecurityPolicyFactory,
    SecurityPolicyNone,
)
from asyncua.server.binary_server_asyncio import BinaryServer

from hilserver.io.opcua_server.frames import FrameReader, Stage, TransportError
from hilserver.io.opcua_server.logs import log
from hilserver.io.opcua_server.processor import RobotProcessor

READ_DEADLINE_S = 2.0
LOGIN_DEADLINE_S = 10.0
_SWEEP_S = 0.2
_CHEAP_S = 0.005
_MAX_QUEUED_BYTES = 256 * 1024
_Codes = ua.StatusCodes


class RobotProtocol(asyncio.Protocol):
    """One connection."""

    def __init__(self, server: "RobotBinaryServer") -> None:
        self._server = server
        self._reader = FrameReader()
        self._frames: asyncio.Queue[tuple[bytes, bytes]] = asyncio.Queue()
        self._queued_bytes = 0
        self._is_reading = True
        self._stage = Stage.NEW
        self._stage_since_s = self._parts_since_s = 0.0
        self._task: asyncio.Task[None] | None = None
        self._transport: Any = None
        self.processor: RobotProcessor | None = None
        self.began_s = 0.0

    def connection_made(self, transport: Any) -> None:
        """Begin to serve a client, if there is room."""
        self.began_s = self._stage_since_s = time.monotonic()
        self._transport = transport
        if not self._server.make_room():
            log.warning("opcua connection refused: too many")
            transport.abort()
            return
        self.processor = RobotProcessor(self._server.iserver, transport, self._server.policies)
        self._server.clients.append(self)
        self._server.iserver.asyncio_transports.append(transport)
        self._task = asyncio.create_task(self._process(), name="opcua connection")

    def connection_lost(self, error: BaseException | None) -> None:  # noqa: ARG002
        """Let go of everything."""
        if self.processor is None:
            return
        self._server.iserver.asyncio_transports.remove(self._transport)
        with contextlib.suppress(ValueError):  # who was evicted is off the list already
            self._server.clients.remove(self)
        if self._task is not None:
            self._task.cancel()
        self._server.closing_tasks.append(asyncio.create_task(self.processor.close()))

    def data_received(self, data: bytes) -> None:
        """Cut frames out of the stream and queue them."""
        if self.processor is None or self._transport.is_closing():
            return
        try:
            for kind, frame in self._reader.feed(data, time.monotonic()):
                self._queued_bytes += len(frame)
                self._frames.put_nowait((kind, frame))
        except TransportError as error:
            self.processor.refuse(error.code, str(error))
        if self._queued_bytes > _MAX_QUEUED_BYTES and self._is_reading:
            self._is_reading = False
            self._transport.pause_reading()

    async def _process(self) -> None:
        assert self.processor is not None
        while True:
            kind, frame = await self._frames.get()
            self._queued_bytes -= len(frame)
            began_s = time.monotonic()
            goes_on = not self._transport.is_closing() and (
                await self.processor.process_frame(kind, frame)
            )
            if not goes_on:
                self._transport.close()
                return
            self._note_progress()
            if not self._is_reading and self._queued_bytes <= _MAX_QUEUED_BYTES // 2:
                self._is_reading = True
                self._transport.resume_reading()
            # A client that asks for much waits as long again: the others come in between.
            took_s = time.monotonic() - began_s
            await asyncio.sleep(took_s if took_s > _CHEAP_S else 0)

    def _note_progress(self) -> None:
        assert self.processor is not None
        now_s = time.monotonic()
        if self.processor.stage is not self._stage:
            self._stage, self._stage_since_s = self.processor.stage, now_s
        if not self.processor.has_parts:
            self._parts_since_s = 0.0
        elif not self._parts_since_s:
            self._parts_since_s = now_s

    @property
    def is_active(self) -> bool:
        """Whether a session is activated on this connection."""
        return self.processor is not None and self.processor.stage is Stage.ACTIVE

    def check_deadlines(self, now_s: float) -> None:
        """Close the connection if it keeps us waiting."""
        if self.processor is None or self._transport.is_closing():
            return
        limit_s = READ_DEADLINE_S - 2 * _SWEEP_S
        since_s = [s for s in (self._reader.since_s, self._parts_since_s) if s and self._is_reading]
        if self.processor.stage < Stage.OPEN:
            since_s.append(self._stage_since_s)
        is_late = any(now_s - since > limit_s for since in since_s)
        if self.processor.stage is Stage.OPEN:
            is_late = is_late or now_s - self._stage_since_s > LOGIN_DEADLINE_S
        if is_late:
            self.processor.refuse(_Codes.BadTimeout, "the rest did not come in time")

    def evict(self) -> None:
        """Close at once: another client needs the place."""
        self._transport.abort()


class RobotBinaryServer(BinaryServer):  # type: ignore[misc]
    """The listening socket and its connections."""

    def __init__(self, iserver: Any, host: str, port: int) -> None:
        super().__init__(iserver, host, port, TransportLimits())
        self._sweeper: asyncio.Task[None] | None = None

    @property
    def policies(self) -> list[Any]:
        """What is offered."""
        return self._policies  # type: ignore[no-any-return]

    def _make_protocol(self) -> RobotProtocol:
        return RobotProtocol(self)

    def make_room(self) -> bool:
        """Whether one more connection may come in; the oldest without a session makes room."""
        if len(self.clients) < self.iserver.max_connections:
            return True
        oldest = next((client for client in self.clients if not client.is_active), None)
        if oldest is None:
            return False
        self.clients.remove(oldest)
        oldest.evict()
        return True

    async def start(self) -> None:
        """Listen, and watch the deadlines."""
        await super().start()
        self._sweeper = asyncio.create_task(self._sweep(), name="opcua deadlines")

    async def stop(self) -> None:
        """Close the socket and all connections."""
        if self._sweeper is not None:
            self._sweeper.cancel()
            await asyncio.gather(self._sweeper, return_exceptions=True)
        await super().stop()

    async def _sweep(self) -> None:
        while True:
            await asyncio.sleep(_SWEEP_S)
            now_s = time.monotonic()
            for client in tuple(self.clients):
                client.check_deadlines(now_s)
            await self._close_tasks()


class RobotUaServer(Server):  # type: ignore[misc]
    """asyncua's server on our socket side."""

    async def start(self) -> None:
        """Listen; OSError if the address cannot be had."""
        self._offer()
        host, port = self._get_bind_socket_info()
        self.bserver = RobotBinaryServer(self.iserver, host, port)
        self.bserver.set_policies(self._policies)
        await self.iserver.start()
        await self.bserver.start()

    def _offer(self) -> None:
        for policy_type in self._security_policy:
            policy, mode, level = SECURITY_POLICY_TYPE_MAP[policy_type]
            certificate = key = None
            if policy is not SecurityPolicyNone:
                certificate, key = self.iserver.certificate, self.iserver.private_key
            self._set_endpoints(policy, mode, level)
            self._policies.append(SecurityPolicyFactory(policy, mode, certificate, key))

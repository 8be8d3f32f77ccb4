"""Answers put and get: one conversation per client, one frame and one group per job."""

import asyncio
import socket
import struct
from collections.abc import Callable, Collection, Mapping
from typing import Final

from hilserver import __version__
from hilserver.config.s7 import S7Server
from hilserver.io.peer_link.samples import FaultKind
from hilserver.io.places import KeptPlace, PlaceKeeper, PlaceUse
from hilserver.io.s7 import wire
from hilserver.io.s7.blocks import DataBlock, RefusedItemError
from hilserver.io.s7.wire import Code, Function, S7Message, WireError
from hilserver.program.event_loop import stop_listening
from hilserver.tasks import SupervisedTask, Supervisor
from hilserver.time_limit import time_limit

_READ_LIST: Final = b"\x44\x01"
"""Group of CPU functions, and the function that reads a system status list."""
COMPONENTS: Final = 0x001C
NO_INFORMATION: Final = 0xD401
_TEXTS: Final = {
    1: "hilserver",
    2: "robot",
    3: "",
    4: "MIT",
    5: __version__,
    7: "simulated robot",
}
"""Index of a record: name of the station, of the module, plant, copyright, serial number, type."""


def identified(message: S7Message) -> bytes:
    """Return the answer to a request of user data: the identification.

    Clocks, passwords, lists of blocks and cyclic services are not supported.
    """
    parameters, data = message.parameters, message.data
    if len(parameters) < 8 or len(data) < 4:
        raise wire.WireError("asks for no user data")
    wanted = struct.unpack(">HH", data[4:8]) if len(data) >= 8 else (0, 0)
    if parameters[5:7] != _READ_LIST or wanted[0] != COMPONENTS:
        return _answer(message, b"\x0a\0\0\0", NO_INFORMATION)
    records = [struct.pack(">H32s", i, text.encode()) for i, text in _TEXTS.items()]
    body = struct.pack(">HHHH", *wanted, 34, len(records)) + b"".join(records)
    return _answer(message, struct.pack(">BBH", 0xFF, 9, len(body)) + body, 0)


def _answer(message: S7Message, data: bytes, error: int) -> bytes:
    group, function, number = message.parameters[5] | 0x80, *message.parameters[6:8]
    parameters = struct.pack(
        ">BBBBBBBBBBH", 0, 1, 0x12, 8, 0x12, group & 0xBF, function, number, 0, 0, error
    )
    return wire.user_data(message.number, parameters, data)


HANDSHAKE_S = MESSAGE_S = 5.0
"""Limits for the handshake of a client, for sending a whole message, for reading an answer."""
JOBS = 8  # parallel jobs that are negotiated; they are answered in order
NO_FUNCTION, NO_ROOM = 0x8104, 0x8500
"""Errors of a whole job: an unknown function, an answer that would be too long."""
ALIVE = {"TCP_KEEPIDLE": 10, "TCP_KEEPINTVL": 5, "TCP_KEEPCNT": 3}
"""A client that vanishes silently gives its place back within half a minute."""

Contents = Callable[[], Mapping[int, bytes]]
Write = Callable[[Mapping[str, object], Collection[str]], Mapping[str, Code]]
Report = Callable[[FaultKind, str, str], None]


class Answers:
    """Answers for one client: bytes in, bytes out.

    Parameters
    ----------
    contents : callable
        All blocks of one frame.
    write : callable
        Takes a group; returns what was refused.
    """

    def __init__(
        self,
        blocks: Mapping[int, DataBlock],
        pdu_bytes: int,
        contents: Contents,
        write: Write,
    ) -> None:
        self._blocks, self.pdu_bytes = blocks, pdu_bytes
        self._contents, self._write = contents, write

    def to(self, message: S7Message) -> bytes:
        """Return the answer to a job; WireError if it is not one."""
        if message.kind == wire.USERDATA:
            return identified(message)
        if not wire.is_job(message):
            raise WireError("asks for nothing")
        function, number = message.parameters[0], message.number
        if function == Function.SETUP:
            jobs, pdu_bytes = wire.agreed(message.parameters)
            self.pdu_bytes = min(self.pdu_bytes, pdu_bytes)
            return wire.answer(
                number, wire.setup(self.pdu_bytes, max(1, min(jobs, JOBS)))
            )
        if function == Function.READ:
            return self._read(number, message.parameters)
        if function == Function.WRITE:
            return self._written(number, message.parameters, message.data)
        return wire.answer(number, b"", error=NO_FUNCTION)

    def _read(self, number: int, parameters: bytes) -> bytes:
        items, contents, data = wire.asked(parameters), self._contents(), b""
        for item in items:
            try:
                piece = self._block(item).read(item, contents[item.block])
                data += b"\0" * (len(data) % 2) + wire.values([(item, piece)])
            except RefusedItemError as error:
                data += wire.refusal(data, error.code)
        if wire.ANSWER_HEAD + 2 + len(data) > self.pdu_bytes:
            return wire.answer(number, b"", error=NO_ROOM)
        return wire.answer(number, bytes((Function.READ, len(items))), data)

    def _written(self, number: int, parameters: bytes, data: bytes) -> bytes:
        items = wire.asked(parameters)
        codes, named, group = [], [], dict[str, object]()
        broken = set[str]()
        for item, (_, piece) in zip(items, wire.pieces(data, len(items)), strict=True):
            try:
                values, code = self._block(item).written(item, piece), Code.DONE
            except RefusedItemError as error:
                values, code = {}, error.code
                block = self._blocks.get(item.block)
                # Where it covers no signal, it may have meant any.
                broken |= (block and block.touched(item)) or {f"DB{item.block}"}
            codes.append(code)
            named.append(values)
            group |= values
        refused = self._write(group, broken) if group else {}
        for index, values in enumerate(named):
            codes[index] = next(
                (refused[n] for n in values if n in refused), codes[index]
            )
        return wire.answer(number, bytes((Function.WRITE, len(items))), bytes(codes))

    def _block(self, item: wire.Item) -> DataBlock:
        if item.block == 0:
            raise RefusedItemError(Code.KIND)
        block = self._blocks.get(item.block)
        if block is None:
            raise RefusedItemError(Code.NO_BLOCK)
        return block


class Server:
    """Listens, and answers a limited number of clients.

    Parameters
    ----------
    answers : callable
        Makes `Answers` for a new client.
    report : callable
        Takes a fault of a client: its kind, the client's address, a sentence.
    """

    def __init__(
        self,
        config: S7Server,
        answers: Callable[[], Answers],
        report: Report,
        tasks: Supervisor | None = None,
    ) -> None:
        self._config, self._answers, self._report = config, answers, report
        self._tasks = Supervisor() if tasks is None else tasks
        self._server: asyncio.Server | None = None
        self.clients: dict[SupervisedTask, KeptPlace] = {}
        self._places = PlaceKeeper(config.max_clients)

    @property
    def port(self) -> int:
        """The port that it listens on."""
        if self._server is None:
            return self._config.port
        port: int = self._server.sockets[0].getsockname()[1]
        return port

    async def start(self) -> None:
        """Listen; OSError if that is impossible."""
        config = self._config
        self._server = await asyncio.start_server(self._enter, config.host, config.port)

    async def stop(self) -> None:
        """Close all connections and stop listening."""
        if self._server is not None:
            await stop_listening(self._server)
        for job in tuple(self.clients):
            await job.end()

    def _enter(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        host = str((writer.get_extra_info("peername") or ["a client"])[0])
        place = self._places.take(host, writer.transport.abort)
        if place is None:
            most = self._config.max_clients
            sentence = f"{host} was turned away: s7.server.max_clients is {most}"
            self._report(FaultKind.NO_ROOM, host, sentence)
            writer.transport.abort()
            return

        def ended() -> None:
            self.clients.pop(job, None)
            self._places.leave(place)
            writer.transport.abort()

        async def serve() -> None:
            await self._serve(place, host, reader, writer)

        job = self._tasks.spawn(serve, "s7 client")
        job.on_end = ended
        self.clients[job] = place

    async def _serve(
        self,
        place: KeptPlace,
        host: str,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
    ) -> None:
        try:
            _stay_alive(writer.get_extra_info("socket"))
            await self._converse(place, reader, writer)
        except WireError as error:
            self._report(FaultKind.NO_S7, host, f"{host}: its message {error}")
        except TimeoutError:
            self._report(FaultKind.NO_S7, host, f"{host}: it neither sends nor reads")
        except (OSError, EOFError):
            pass  # the client is gone

    async def _converse(
        self,
        place: KeptPlace,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
    ) -> None:
        answers = self._answers()
        async with time_limit(HANDSHAKE_S):
            writer.write(wire.confirmed(await wire.receive(reader)))
        while True:
            message = wire.taken_apart(await wire.receive(reader, MESSAGE_S))
            writes = message.parameters[:1] == bytes((Function.WRITE,))
            self._places.progress(
                place, PlaceUse.DRIVES if writes else PlaceUse.WATCHES
            )
            writer.write(answers.to(message))
            async with time_limit(MESSAGE_S):
                await writer.drain()
            # a client that never waits must not block the others
            await asyncio.sleep(0)


def _stay_alive(connection: socket.socket) -> None:
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    for name, value in ALIVE.items():
        connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)

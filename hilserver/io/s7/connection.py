"""One connection to a controller: open, read and write pieces of its blocks, until its first error.

Data longer than a message is sent in parts: reads from the first byte of a block to the last,
writes from the last to the first. If a block has the same counter at both ends, a reader that finds
them equal therefore has values of one cycle.
"""

import asyncio
import contextlib
import socket
from collections.abc import Iterator, Sequence
from typing import NamedTuple, Self

from hilserver.config.s7 import Endpoint
from hilserver.io.peer_link.samples import FaultKind, LinkLostError, LinkRefusedError
from hilserver.io.s7 import wire
from hilserver.io.s7.wire import Code, Function, Item, S7Message, WireError
from hilserver.time_limit import time_limit

CONNECT_S = 3.0
JOB_S = 2.0
ASKED_PDU = 480  # requested bytes of a message; controllers grant 240 to 960

WHY = {
    Code.NO_BLOCK: "there is no such block, or it has optimized access: switch that off in the"
    " properties of the block",
    Code.BEYOND: "the block is too short",
    Code.DENIED: "access is denied: permit access with PUT/GET in the protection settings of the"
    " controller",
}


class S7Write(NamedTuple):
    """Bytes, or one bit, to write from a given bit of a block on."""

    item: Item
    data: bytes


class AnswerError(Exception):
    """The controller answered that it cannot read or write; the connection stays open."""


class S7Connection:
    """An open connection; use it as an async context manager."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._number = 0
        self._turn = asyncio.Lock()
        self.pdu_bytes = ASKED_PDU  # longest message, as agreed

    async def __aenter__(self) -> Self:
        try:
            async with time_limit(CONNECT_S):
                await self._open()
        except WireError as error:
            raise LinkLostError(f"its answer {error}") from None
        return self

    async def _open(self) -> None:
        host, port, rack, slot = self._endpoint
        self._reader, self._writer = await asyncio.open_connection(host, port)
        try:
            self._writer.get_extra_info("socket").setsockopt(
                socket.IPPROTO_TCP, socket.TCP_NODELAY, 1
            )
            self._writer.write(wire.connect_request(rack, slot))
            if not wire.is_confirmed(await self._received()):
                raise _no_slot(rack, slot)
            answer = await self._exchange(wire.setup(ASKED_PDU))
            self.pdu_bytes = wire.agreed(answer.parameters)[1]
        except EOFError:
            self._writer.transport.abort()
            raise _no_slot(rack, slot) from None
        except BaseException:
            self._writer.transport.abort()
            raise

    async def __aexit__(self, *_: object) -> None:
        self._writer.transport.abort()
        with contextlib.suppress(OSError):
            await self._writer.wait_closed()

    async def read(self, block: int, start: int, size: int) -> bytes:
        """Return `size` bytes of a block; AnswerError or LinkLostError."""
        data, step = b"", (self.pdu_bytes - wire.READ_OVERHEAD) // 2 * 2
        for at in range(start, start + size, step):
            item = Item(block, 8 * at, min(step, start + size - at))
            answer = await self._asked(wire.asks(Function.READ, [item]))
            try:
                ((code, piece),) = wire.pieces(answer.data, 1)
            except WireError as error:
                raise LinkLostError(f"its answer {error}") from None
            _check(block, code)
            if len(piece) != item.size:
                raise LinkLostError(
                    "the controller answered a read with the wrong length"
                )
            data += piece
        return data

    async def write(self, runs: Sequence[S7Write]) -> None:
        """Write, in several messages if needed, the last bytes first.

        AnswerError or LinkLostError.
        """
        for part in parts(runs, self.pdu_bytes):
            items = [run.item for run in part]
            data = wire.values(part, 0)
            answer = await self._asked(wire.asks(Function.WRITE, items), data)
            if len(answer.data) != len(items):
                raise LinkLostError(
                    "the controller answered a write with the wrong length"
                )
            for item, code in zip(items, answer.data, strict=True):
                _check(item.block, code)

    async def _asked(self, parameters: bytes, data: bytes = b"") -> S7Message:
        try:
            async with self._turn, time_limit(JOB_S):
                return await self._exchange(parameters, data)
        except WireError as error:
            raise LinkLostError(f"its answer {error}") from None
        except EOFError:
            raise LinkLostError("the controller closed the connection") from None

    async def _exchange(self, parameters: bytes, data: bytes = b"") -> S7Message:
        self._number = self._number % 0xFFFF + 1
        self._writer.write(wire.job(self._number, parameters, data))
        answer = wire.taken_apart(await self._received())
        if answer.number != self._number:
            raise WireError("belongs to another job")
        if answer.error or answer.parameters[:1] != parameters[:1]:
            raise WireError(f"is error {answer.error:#06x}")
        return answer

    async def _received(self) -> tuple[int, bytes]:
        return await wire.receive(self._reader)


def _no_slot(rack: int, slot: int) -> LinkRefusedError:
    sentence = (
        f"not connected: there is no controller in rack {rack}, slot {slot}, or it has no free"
        f" connection: an S7-1500 or S7-1200 is in slot 1, an S7-300 in slot 2"
    )
    return LinkRefusedError(FaultKind.NO_SLOT, "slot", sentence)


def _check(block: int, code: int) -> None:
    if code != Code.DONE:
        why = WHY[Code(code)] if code in WHY else f"code {code:#04x}"
        raise AnswerError(f"DB{block}: {why}")


def parts(runs: Sequence[S7Write], pdu_bytes: int) -> Iterator[list[S7Write]]:
    """Yield the runs for one message each, from the last byte to the first."""
    room = pdu_bytes - wire.WRITE_OVERHEAD + wire.ITEM_OVERHEAD
    part: list[S7Write] = []
    left = room
    for run in reversed(list(_short(runs, (room - wire.ITEM_OVERHEAD) // 2 * 2))):
        needed = wire.ITEM_OVERHEAD + len(run.data)
        if part and (needed > left or len(part) == wire.MOST_ITEMS):
            yield part
            part, left = [], room
        part.append(run)
        left -= needed
    if part:
        yield part


def _short(runs: Sequence[S7Write], longest: int) -> Iterator[S7Write]:
    for item, data in runs:
        for at in range(0, len(data), longest):
            piece = data[at : at + longest]
            yield S7Write(item._replace(bit=item.bit + 8 * at, size=len(piece)), piece)

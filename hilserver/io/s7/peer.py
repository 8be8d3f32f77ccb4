"""An S7 controller, or PLCSIM Advanced, as a peer: its block is read, ours written, cyclically."""

import asyncio
import time
from collections.abc import Iterator, Mapping
from typing import Any

from hilserver.config.peers import PeerConfig
from hilserver.config.s7 import BlockPlace, Endpoint
from hilserver.config.s7_peer import Block
from hilserver.faults.links import Lane
from hilserver.io.peer_link.intake import FaultyIntake
from hilserver.io.peer_link.link import Peer
from hilserver.io.peer_link.samples import FaultKind, judge_value
from hilserver.io.s7.blocks import COUNTING, check_type, packed, unpacked
from hilserver.io.s7.connection import AnswerError, S7Connection, S7Write
from hilserver.io.s7.wire import Item
from hilserver.period import every
from hilserver.signals import SignalTable
from hilserver.status import is_bad
from hilserver.tasks import together

LOOK_AGAIN_S = 1.0  # pause after the controller has refused a block
SOONER = 8  # reads come 1/8 period early, and every 1/8 period while the counter stands


class ReadPace:
    """When a block is read next: soon while its counter stands, so that reads follow the writes.

    Two cycles of equal length keep the lag they started with. Reading a little early, and then
    repeatedly until the counter has moved, limits the lag to an eighth of a period. A counter that
    stands for a whole period is read once per period.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s, self._seen, self._stood = period_s, object(), 0

    def after(self, counter: object) -> float:
        """Return how long [s] after a read with this counter the next is due; None: a torn read."""
        if counter is not None and counter != self._seen:
            self._seen, self._stood = counter, 0
            return self._period_s * (SOONER - 1) / SOONER
        self._stood += 1
        return self._period_s / (SOONER if self._stood <= SOONER else 1)


class S7Peer(Peer):
    """Reads one block of a controller and writes one.

    ConfigError if the type of a place does not fit its signal.
    """

    def __init__(self, config: PeerConfig, table: SignalTable, **around: Any) -> None:
        super().__init__(config, **around)
        self._coming, self._going = config.blocks
        self._beat = 0
        for text in config.read:
            for name in config.inputs_of(text):
                check_type(
                    table[name], self._coming.places[text].type if self._coming else ""
                )
        self._wraps = {name: table[name].type in COUNTING for name in config.write}
        for name, text in config.write.items():
            check_type(
                table[name], self._going.places[text].type if self._going else ""
            )

    async def converse(self) -> None:
        """Serve one connection."""
        async with S7Connection(Endpoint.parse(self.config.endpoint)) as connection:
            intake, status = self.enter(), self.status
            status.mode, status.mode_reason = (
                "poll",
                f"S7, {connection.pdu_bytes} bytes a message",
            )
            self._intake.expect(self.config.read, time.monotonic_ns())
            ways = [self.wait_cut(), intake.run()]
            if self._coming is not None:
                ways.append(self._read_on(self._coming, connection, intake))
            if self._going is not None:
                ways.append(self._write_on(self._going, connection))
            await together(*ways)

    # --- in ---------------------------------------------------------------------------------------

    async def _read_on(
        self, block: Block, connection: S7Connection, intake: FaultyIntake
    ) -> None:
        status, period_s = self.status, self.config.poll_ms / 1000
        pace = ReadPace(period_s)

        async def cycle() -> float | None:
            sent_ns = time.monotonic_ns()
            try:
                data = await connection.read(
                    block.number, block.start, block.end - block.start
                )
            except AnswerError as error:
                await self._refused(FaultKind.MISSING_NODE, block, error)
                return None
            now_ns = time.monotonic_ns()
            status.round_trip.observe(now_ns - sent_ns)
            values = {
                text: unpacked(p, data, block.start) for text, p in block.places.items()
            }
            if len({values[end] for end in block.heartbeat}) > 1:
                sentence = (
                    f"DB{block.number} was read while it was being written: dropped"
                )
                self._faults.report(
                    FaultKind.TORN_READ, f"DB{block.number}", sentence, now_ns
                )
                return pace.after(None)
            intake.receive(
                ((text, judge_value(v)) for text, v in values.items()), now_ns
            )
            return pace.after(values[block.heartbeat[0]]) if block.heartbeat else None

        def skipped(count: int) -> None:
            status.polls_skipped += count

        await every(period_s, cycle, skipped)

    async def _refused(self, kind: FaultKind, block: Block, error: AnswerError) -> None:
        self._faults.report(kind, f"DB{block.number}", str(error), time.monotonic_ns())
        await asyncio.sleep(LOOK_AGAIN_S)

    # --- out --------------------------------------------------------------------------------------

    async def _write_on(self, block: Block, connection: S7Connection) -> None:
        status, lane = self.status, Lane[list[S7Write]](self._line, "out")

        async def cycle() -> None:
            outgoing = self._outgoing(block)
            if outgoing is not None:
                lane.put(list(runs(block.number, outgoing)))
            try:
                for due in lane.take():
                    await connection.write(due)
                    status.writes += 1
            except AnswerError as error:
                await self._refused(FaultKind.REFUSED_WRITE, block, error)

        def skipped(count: int) -> None:
            status.writes_skipped += count

        await every(self.config.write_every_ms / 1000, cycle, skipped)

    def _outgoing(self, block: Block) -> Mapping[BlockPlace, bytes] | None:
        """Return the values to write now; None before the first frame."""
        found = {}
        try:
            outputs = {name: self._read_output(name) for name in self.config.write}
        except LookupError:
            return None
        for name, (value, status, _) in outputs.items():
            if is_bad(status) or not isinstance(value, int | float):
                continue  # without a status it would pass for a good value
            place = block.places[self.config.write[name]]
            found[place] = packed(place, value, wraps=self._wraps[name])
        self._beat += 1
        for end in block.heartbeat:
            place = block.places[end]
            found[place] = packed(place, self._beat, wraps=True)
        return found


def runs(block: int, pieces: Mapping[BlockPlace, bytes]) -> Iterator[S7Write]:
    """Yield the runs to write, ascending: adjacent bytes together, every bit separately."""
    data, begin = b"", 0
    for place in sorted(pieces, key=lambda place: place.bits.start):
        is_bit = place.type == "BOOL"
        if data and (is_bit or begin + len(data) != place.byte):
            yield S7Write(Item(block, 8 * begin, len(data)), data)
            data = b""
        if is_bit:
            yield S7Write(Item(block, place.bits.start, 1, kind=1), pieces[place])
            continue
        begin = begin if data else place.byte
        data += pieces[place]
    if data:
        yield S7Write(Item(block, 8 * begin, len(data)), data)

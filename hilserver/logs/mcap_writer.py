"""MCAP, in chunks, so that a killed recorder loses a fraction of a second.

Whole chunks of messages are built as one NumPy array; the other records come from the package
``mcap``. Only complete records are written, so a file without its end (kill -9, full disk) still
has every chunk up to there. https://mcap.dev/spec
"""

import json
import struct
import time
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap import records as rec
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from hilserver import __version__
from hilserver.errors import NO_SPACE
from hilserver.logs import changes as sparse
from hilserver.logs.log import Change, RecordedState
from hilserver.logs.message import (
    CDR_LITTLE_ENDIAN,
    SCHEMA_NAME,
    make_layout,
    payload_dtype,
)
from hilserver.logs.writer import Segmented, WholeFile

TOPIC = "/hilserver/frame"
CHANGES_SCHEMA = "hilserver.Parameters"
METADATA = "hilserver"
CONFIG_ATTACHMENT = "config.yaml"
STATE_ATTACHMENT = "state"
CHANNEL, CHANGES = 1, 2
"""Numbers of the channels; the parameters' channel is only in files with changes."""
CHUNK_BYTES = 1 << 20
CHUNKS_FOR_INDEX = 5
USUAL_COMPRESSION = 8


def record_dtype(n_signals: int) -> np.dtype[np.void]:
    """Return a whole Message record, from opcode to payload, as a packed NumPy record."""
    head = [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
    ]
    times = [("log_time", "<u8"), ("publish_time", "<u8")]
    return np.dtype([*head, *times, ("payload", payload_dtype(n_signals))])


class McapWriter:
    """Writes one MCAP recording; see `LogWriter`."""

    def __init__(
        self,
        path: Path,
        run: Mapping[str, Any],
        slots: Sequence[int],
        utc_minus_monotonic_ns: int,
    ) -> None:
        signals = [run["signals"][slot] for slot in slots]
        slot_of = {s["name"]: slot for s, slot in zip(signals, slots, strict=True)}
        layout = make_layout(list(slot_of))
        self._slots = np.array([slot_of[name] for name in layout.names], dtype=np.intp)
        self._dtype = record_dtype(len(layout.names))
        self._utc_ns = utc_minus_monotonic_ns
        self._pending: list[NDArray[np.void]] = []
        self._pending_bytes = 0
        self._changed: list[tuple[int, Change]] = []
        self._schema = rec.Schema(
            id=1, data=layout.schema.encode(), encoding="ros2msg", name=SCHEMA_NAME
        )
        units = {s["name"]: s["unit"] for s in signals}
        self._channel = rec.Channel(
            id=CHANNEL,
            topic=TOPIC,
            message_encoding="cdr",
            schema_id=1,
            metadata={
                "signals": json.dumps({name: units[name] for name in layout.names})
            },
        )
        self._summary = _Summary([self._schema], [self._channel])
        self._file = WholeFile(path)
        self._append(rec.Header("", f"hilserver {__version__}"), magic=True)
        self._append(self._schema)
        self._append(self._channel)
        self.tell(run)
        self._attach(
            CONFIG_ATTACHMENT, "application/yaml", (run["configuration"] or "").encode()
        )

    @property
    def n_bytes(self) -> int:
        """Size of the file so far, including an estimate for the pending chunk."""
        return self._file.size + self._pending_bytes // USUAL_COMPRESSION

    def write(self, batch: Segmented) -> None:
        """Append a message for each frame."""
        frames = batch.frames
        table = np.zeros(len(frames), dtype=self._dtype)
        table["opcode"] = Opcode.MESSAGE
        table["length"] = self._dtype.itemsize - 9
        table["channel"] = CHANNEL
        table["sequence"] = frames.numbers & 0xFFFF_FFFF
        table["log_time"] = table["publish_time"] = frames.planned_ns + self._utc_ns
        payload = table["payload"]
        payload["cdr"] = CDR_LITTLE_ENDIAN
        payload["number"] = frames.numbers
        payload["segment"] = batch.segments
        payload["tick"] = frames.ticks
        payload["planned_ns"] = frames.planned_ns
        payload["values"] = frames.values[:, self._slots]
        payload["status"] = frames.status[:, self._slots]
        self._pending.append(table)
        self._pending_bytes += table.nbytes
        self._changed += [
            (int(frames.planned_ns[0]) + self._utc_ns, c) for c in batch.changes
        ]
        if self._pending_bytes >= CHUNK_BYTES:
            self.flush()

    def add_state(self, state: RecordedState) -> None:
        """Append a state to replay from."""
        name = f"{STATE_ATTACHMENT}-{state.segment}-{state.tick}"
        self._attach(
            name, "application/octet-stream", state.words.astype("<i8").tobytes()
        )

    def tell(self, run: Mapping[str, Any]) -> None:
        """Say where the recording comes from; the last call counts."""
        texts = {
            key: value if isinstance(value, str) else json.dumps(value)
            for key, value in run.items()
            if key != "configuration"
        }
        offset = self._file.size
        length = self._append(rec.Metadata(name=METADATA, metadata=texts))
        index = rec.MetadataIndex(offset=offset, length=length, name=METADATA)
        self._summary.metadata.append(index)

    def _attach(self, name: str, media_type: str, data: bytes) -> None:
        offset = self._file.size
        now_ns = time.time_ns()
        length = self._append(rec.Attachment(now_ns, now_ns, name, media_type, data))
        self._summary.attachments.append(
            rec.AttachmentIndex(
                offset, length, now_ns, now_ns, len(data), name, media_type
            )
        )

    def _append(self, record: rec.McapRecord, *, magic: bool = False) -> int:
        data = _encode(record)
        self._file.append(MCAP0_MAGIC + data if magic else data)
        return len(data)

    def flush(self) -> None:
        """Write what is pending, frames and changes in a chunk each."""
        if self._pending:
            table = np.concatenate(self._pending)
            self._pending = []
            self._pending_bytes = 0
            times = table["log_time"].tolist()
            self._summary.add(
                self._file, CHANNEL, times, table.tobytes(), table.dtype.itemsize
            )
        if self._changed:
            changed = self._changed
            self._changed = []
            if len(self._summary.channels) == 1:
                schema = json.dumps(sparse.SCHEMA).encode()
                own: tuple[rec.Schema, rec.Channel] = (
                    rec.Schema(
                        data=schema,
                        encoding="jsonschema",
                        id=CHANGES,
                        name=CHANGES_SCHEMA,
                    ),
                    rec.Channel(CHANGES, sparse.TOPIC, "json", {}, CHANGES),
                )
                self._summary.schemas.append(own[0])
                self._summary.channels.append(own[1])
                for record in own:
                    self._append(record)
            for stamp_ns, change in changed:
                text = sparse.as_text(change).encode()
                number = change.number & 0xFFFF_FFFF
                message = _encode(
                    rec.Message(CHANGES, stamp_ns, text, stamp_ns, number)
                )
                self._summary.add(
                    self._file, CHANGES, [stamp_ns], message, len(message)
                )

    def sync(self) -> None:
        """Hand everything to the disk."""
        self.flush()
        self._file.sync()

    def close(self) -> None:
        """Write the last chunk, the index and the end; close the file in any case.

        On a full disk, up to a second of the recording is dropped to make room for the index; no
        other error of a disk goes away by that.
        """
        try:
            self.flush()
            for left in reversed(range(CHUNKS_FOR_INDEX + 1)):
                index = self._summary.encode(self._file.size)
                try:
                    self._file.append(index)
                    return
                except OSError as error:
                    has_space = error.errno not in NO_SPACE
                    if has_space or not left or not self._summary.chunks:
                        raise
                    self._file.cut(self._summary.drop_last())
        finally:
            self._file.close()


class _Summary:
    """The index at the end of the file, collected chunk by chunk."""

    def __init__(self, schemas: list[rec.Schema], channels: list[rec.Channel]) -> None:
        self.schemas = schemas
        self.channels = channels
        self.chunks: list[rec.ChunkIndex] = []
        self.metadata: list[rec.MetadataIndex] = []
        self.attachments: list[rec.AttachmentIndex] = []
        self._n_messages: list[tuple[int, int]] = []
        self._compressor = zstandard.ZstdCompressor(level=1)

    def add(
        self,
        file: WholeFile,
        channel: int,
        times_ns: Sequence[int],
        data: bytes,
        each: int,
    ) -> None:
        """Write messages of `each` bytes as a chunk with its index, and remember its position."""
        start_ns = min(times_ns)
        end_ns = max(times_ns)
        packed = self._compressor.compress(data)
        chunk = _encode(
            rec.Chunk("zstd", packed, end_ns, start_ns, zlib.crc32(data), len(data))
        )
        entries = np.empty((len(times_ns), 2), dtype="<u8")
        entries[:, 0] = times_ns
        entries[:, 1] = np.arange(len(times_ns)) * each
        places = entries.tobytes()
        head = struct.pack(
            "<BQHI", Opcode.MESSAGE_INDEX, 6 + len(places), channel, len(places)
        )
        index = head + places
        offset = file.size
        file.append(chunk + index)
        self.chunks.append(
            rec.ChunkIndex(
                chunk_length=len(chunk),
                chunk_start_offset=offset,
                compression="zstd",
                compressed_size=len(packed),
                message_end_time=end_ns,
                message_index_length=len(index),
                message_index_offsets={channel: offset + len(chunk)},
                message_start_time=start_ns,
                uncompressed_size=len(data),
            )
        )
        self._n_messages.append((channel, len(times_ns)))

    def drop_last(self) -> int:
        """Forget the last chunk and what follows it; return where it begins."""
        start = self.chunks.pop().chunk_start_offset
        self._n_messages.pop()
        self.metadata = [m for m in self.metadata if m.offset < start]
        self.attachments = [a for a in self.attachments if a.offset < start]
        return start

    def encode(self, position: int) -> bytes:
        """Return everything from the end of the data to the end of the file."""
        counts = {
            channel.id: sum(n for number, n in self._n_messages if number == channel.id)
            for channel in self.channels
        }
        statistics = rec.Statistics(
            attachment_count=len(self.attachments),
            channel_count=len(self.channels),
            channel_message_counts=counts,
            chunk_count=len(self.chunks),
            message_count=sum(counts.values()),
            message_end_time=max((c.message_end_time for c in self.chunks), default=0),
            message_start_time=min(
                (c.message_start_time for c in self.chunks), default=0
            ),
            metadata_count=len(self.metadata),
            schema_count=len(self.schemas),
        )
        data_end = _encode(rec.DataEnd(0))
        groups: list[tuple[Opcode, Sequence[rec.McapRecord]]] = [
            (Opcode.SCHEMA, self.schemas),
            (Opcode.CHANNEL, self.channels),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self.chunks),
            (Opcode.ATTACHMENT_INDEX, self.attachments),
            (Opcode.METADATA_INDEX, self.metadata),
        ]
        start = position + len(data_end)
        summary, offsets = b"", b""
        for opcode, group in groups:
            text = b"".join(_encode(record) for record in group)
            if text:
                offsets += _encode(
                    rec.SummaryOffset(opcode, start + len(summary), len(text))
                )
            summary += text
        offset_start = start + len(summary)
        head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start)
        crc = zlib.crc32(summary + offsets + head)
        return (
            data_end + summary + offsets + head + struct.pack("<I", crc) + MCAP0_MAGIC
        )


def _encode(record: rec.McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]

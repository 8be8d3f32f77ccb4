"""MCAP recordings of hilserver, complete or torn: every whole chunk is read, indexed or not."""

import json
import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import zstandard
from mcap import records as rec
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from hilserver.errors import LogError
from hilserver.logs import changes as sparse
from hilserver.logs.log import Change, Log, RecordedState
from hilserver.logs.mcap_writer import (
    CHANGES,
    CONFIG_ATTACHMENT,
    METADATA,
    STATE_ATTACHMENT,
    TOPIC,
    record_dtype,
)
from hilserver.logs.provenance import SCHEMA, check_run
from hilserver.logs.table import BLOCK, TIME
from hilserver.logs.unpacking import PIECE_BYTES, Budget
from hilserver.status import BAD

_MESSAGE_HEAD = 9 + 22  # bytes of a record before the data of its message
_TEXTS = ("schema", "version", "kernels", "config_sha256", "config_folder", "replay_of")
_READ = {
    Opcode.CHANNEL: rec.Channel.read,
    Opcode.CHUNK: rec.Chunk.read,
    Opcode.METADATA: rec.Metadata.read,
    Opcode.ATTACHMENT: rec.Attachment.read,
}


@dataclass
class Contents:
    """The content of the records of a file."""

    names: list[str] = field(default_factory=list)
    tables: list[NDArray[np.void]] = field(default_factory=list)
    run: dict[str, Any] = field(default_factory=dict)
    configuration: str | None = None
    states: list[RecordedState] = field(default_factory=list)
    changes: list[Change] = field(default_factory=list)
    ended: bool = False

    def take(self, record: rec.McapRecord, budget: Budget) -> None:
        """Take one record; foreign ones do not matter."""
        if isinstance(record, rec.Channel) and record.topic == TOPIC:
            names = list(json.loads(record.metadata["signals"]))
            if self.names not in ([], names):
                raise ValueError("two lists of signals")
            self.names = names
        elif isinstance(record, rec.Chunk) and self.names:
            data = budget.unpack(record)
            if data[9:11] == CHANGES.to_bytes(2, "little"):
                self.changes.append(sparse.from_text(data[_MESSAGE_HEAD:]))
            else:
                n_signals = len(self.names)
                table = np.frombuffer(data, dtype=record_dtype(n_signals))
                if not (table["opcode"] == Opcode.MESSAGE).all():
                    raise ValueError("foreign records in a chunk")
                payload: NDArray[np.void] = table["payload"]
                self.tables.append(payload)
        elif isinstance(record, rec.Metadata) and record.name == METADATA:
            self.run = {
                key: text if key in _TEXTS else json.loads(text)
                for key, text in record.metadata.items()
            }
        elif isinstance(record, rec.Attachment) and record.name == CONFIG_ATTACHMENT:
            self.configuration = record.data.decode() or None
        elif isinstance(record, rec.Attachment) and record.name.startswith(
            STATE_ATTACHMENT
        ):
            _, segment, tick = record.name.split("-")
            words = np.frombuffer(record.data, dtype="<i8").astype(np.int64)
            self.states.append(RecordedState(int(segment), int(tick), words))


def read_mcap(path: Path) -> Log:
    """Read a recording; see `reading.read_log`."""
    contents = Contents()
    for _ in _taken(path, contents):
        pass
    return to_log(path, contents)


def read_mcap_pieces(path: Path) -> Iterator[Log]:
    """Yield a recording as one log for each of its chunks, so that memory does not grow."""
    contents = Contents()
    for _ in _taken(path, contents):
        if contents.tables:
            yield to_log(path, contents)
            contents.tables.clear()
    if contents.tables or not contents.names:
        yield to_log(path, contents)


def _taken(path: Path, contents: Contents) -> Iterator[None]:
    """Take record after record into `contents`; yield after each."""
    budget = Budget(path)
    with path.open("rb") as file:
        if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            raise LogError(f"{path}: not an MCAP file; is its beginning missing?")
        for offset, opcode, body in records_of(file):
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                contents.ended = True
                break
            try:
                if opcode in _READ:
                    contents.take(
                        _READ[Opcode(opcode)](ReadDataStream(BytesIO(body))), budget
                    )
            except (
                ValueError,
                KeyError,
                TypeError,
                struct.error,
                zstandard.ZstdError,
                EndOfFile,
                RecursionError,
                zlib.error,
            ):
                raise LogError(
                    f"{path}: the record at byte {offset} is damaged; truncate the file there to"
                    " read what comes before it"
                ) from None
            yield


def records_of(file: BinaryIO) -> Iterator[tuple[int, int, bytes]]:
    """Yield offset, opcode and body of every whole record; a torn last one ends it.

    A record larger than a piece may be comes without its body.
    """
    begin = file.tell()
    size = file.seek(0, os.SEEK_END)
    file.seek(begin)
    while True:
        offset = file.tell()
        head = file.read(9)
        if len(head) < 9:
            return
        opcode, length = struct.unpack("<BQ", head)
        if opcode == 0 or length > size - offset - len(head):
            return
        if length > PIECE_BYTES:
            yield offset, opcode, b""
            file.seek(offset + len(head) + length)
            continue
        yield offset, opcode, file.read(length)


def to_log(path: Path, contents: Contents, notices: Sequence[str] = ()) -> Log:
    """Return the log in the records of a file."""
    run = contents.run
    if not contents.names or run.get("schema") != SCHEMA:
        raise LogError(
            f"{path}: contains no hilserver recording (no topic {TOPIC}); give a mapping of its"
            " topics"
        )
    run["configuration"] = contents.configuration
    try:
        check_run(run, contents.names)
        if run.get("foreign") and TIME not in contents.names:
            raise ValueError("is damaged: it has no times")
    except ValueError as error:
        raise LogError(
            f"{path}: its record of the run {error}; record it again"
        ) from None
    table = (
        np.concatenate(contents.tables)
        if contents.tables
        else np.empty(0, dtype=record_dtype(len(contents.names))["payload"])
    )
    values = np.array(table["values"].T, order="C")
    status = np.array(table["status"].T, dtype=np.int64, order="C")
    values[(status & BAD) != 0] = np.nan
    notices = list(notices)
    if not contents.ended:
        notices.append(
            f"{path}: the recorder did not close the file; its last part is missing"
        )
    lost = int((np.diff(table["number"]) - 1).sum()) if len(table) else 0
    if lost > 0:
        notices.append(f"{path}: {lost} frames were lost while recording")
    columns = dict(zip(contents.names, values, strict=True))
    segment = table["segment"].astype(np.int64)
    if run.get("foreign"):
        t_s, block = columns.pop(TIME), columns.pop(BLOCK, None)
        blocks = None if block is None else block.astype(np.int64)
        return Log(path, t_s, segment, columns, blocks, notices=notices)
    return Log(
        path=path,
        t_s=table["tick"] * (int(run["base_period_ns"]) * 1e-9),
        segment=segment,
        columns=columns,
        status=dict(zip(contents.names, status, strict=True)),
        run=run,
        states=contents.states,
        changes=contents.changes,
        notices=notices,
    )

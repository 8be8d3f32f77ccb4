"""The messages of ROS 2 bags, sqlite3 and MCAP, read without ROS; torn ones as far as possible."""

import sqlite3
import struct
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Final, cast

import zstandard
from mcap import records as rec
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from hilserver.errors import LogError
from hilserver.logs.mcap_reader import records_of
from hilserver.logs.unpacking import PIECE_BYTES, ZSTD_MAGIC, Budget

SUFFIXES = (".db3", ".mcap")
PACKED = tuple(f"{suffix}.zstd" for suffix in SUFFIXES)
# of sqlite's machine: more than any table of this size needs
STEPS_PER_BYTE: Final = 10
_BROKEN = (ValueError, KeyError, struct.error, EndOfFile, McapError, RuntimeError)
_TORN = "the recorder did not close the file; its contents were read"


@dataclass(frozen=True, slots=True)
class Topic:
    """What a bag says about a topic; the definition is empty if it holds none."""

    type: str
    definition: str = ""
    # of the definition: ``ros2msg``, ``ros2idl``, ``ros1msg``, ``jsonschema``
    encoding: str = "ros2msg"
    serialization: str = "cdr"  # of the messages: ``cdr``, ``ros1``, ``json``


@dataclass
class Bag:
    """The messages of one file."""

    path: Path
    topics: dict[str, Topic] = field(default_factory=dict)
    # stamp of reception [ns] and the message, for the requested topics
    messages: dict[str, list[tuple[int, bytes]]] = field(default_factory=dict)
    notices: list[str] = field(default_factory=list)
    most: int | None = None  # messages kept per topic; None for all

    def take(self, name: str, stamp_ns: int, data: bytes, budget: Budget) -> None:
        """Keep a message; one that was compressed on its own is unpacked."""
        kept = self.messages.setdefault(name, [])
        if self.most is not None and len(kept) >= self.most:
            return
        if data.startswith(ZSTD_MAGIC):
            data = budget.unzstd(data)
        budget.keep(len(data))
        kept.append((stamp_ns, data))


def is_bag(path: Path) -> bool:
    """Return whether a path looks like a bag."""
    return path.name.endswith((*SUFFIXES, *PACKED)) or path.is_dir()


def read_messages(path: Path, wanted: set[str], most: int | None = None) -> list[Bag]:
    """Read some topics of a file or folder, one `Bag` per file; LogError if that is impossible.

    At most `most` messages of a topic are kept.
    """
    return [_read_file(file, wanted, most) for file in _files(path)]


def _files(path: Path) -> Sequence[Path]:
    if not path.is_dir():
        return [path]
    files = {
        file.name: file
        for file in sorted(path.iterdir())
        if is_bag(file) and file.is_file()
    }
    twice = {
        name for name in files if name.removesuffix(".zstd") in files.keys() - {name}
    }
    if not files:
        raise LogError(
            f"{path}: the folder contains no bag (.db3 or .mcap); name the log itself"
        )
    return [file for name, file in files.items() if name not in twice]


def _read_file(path: Path, wanted: set[str], most: int | None) -> Bag:
    budget = Budget(path)
    bag = Bag(path, most=most)
    if not path.name.endswith(PACKED):
        return _read_plain(bag, path, wanted, budget)
    with tempfile.TemporaryDirectory(prefix="hilserver-") as folder:
        plain = Path(folder) / path.stem
        try:
            budget.unzstd_file(path, plain)
        except zstandard.ZstdError as error:
            raise LogError(
                f"{path}: cannot be decompressed ({error}); copy it again"
            ) from None
        return _read_plain(bag, plain, wanted, budget)


def _read_plain(bag: Bag, plain: Path, wanted: set[str], budget: Budget) -> Bag:
    read = _read_sqlite if plain.suffix == ".db3" else _read_mcap
    read(bag, plain, wanted, budget)
    return bag


def _read_sqlite(bag: Bag, file: Path, wanted: set[str], budget: Budget) -> None:
    size = file.stat().st_size
    file.open("rb").close()  # the system's own message if it cannot be opened
    connection = sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, PIECE_BYTES)
    connection.text_factory = lambda text: text.decode(errors="replace")
    calls = iter(range(STEPS_PER_BYTE * size // 1000 + 1000))
    connection.set_progress_handler(lambda: next(calls, None) is None, 1000)
    try:
        _take_sqlite(connection, bag, wanted, budget)
    except (
        sqlite3.Error,
        UnicodeDecodeError,
    ) as error:  # the latter in an error message of sqlite
        if not any(bag.messages.values()):
            raise LogError(
                f"{bag.path}: not a readable bag ({error}); copy it again, or run 'ros2 bag"
                " reindex'"
            ) from None
        bag.notices.append(
            f"{bag.path}: is damaged ({error}); everything before that was read"
        )
    finally:
        connection.close()


def _take_sqlite(
    connection: sqlite3.Connection, bag: Bag, wanted: set[str], budget: Budget
) -> None:
    query = "SELECT name, type, sql FROM sqlite_master"
    tables = {
        name for name, kind, sql in connection.execute(query)
        if kind == "table" and "VIRTUAL" not in str(sql).upper()
    }  # fmt: skip
    if missing := {"topics", "messages"} - tables:
        raise sqlite3.DatabaseError(f"no table {min(missing)}")
    definitions: dict[str, tuple[str, str]] = {}
    if "message_definitions" in tables:
        query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        definitions = {
            row[0]: (str(row[2]), str(row[1])) for row in connection.execute(query)
        }
    names = {}
    query = "SELECT id, name, type, serialization_format FROM topics"
    for number, name, kind, serialization in connection.execute(query):
        given = definitions.get(kind, ("", "ros2msg"))
        bag.topics[str(name)] = Topic(
            str(kind), *given, serialization=str(serialization)
        )
        names[number] = str(name)
    query = "SELECT topic_id, timestamp, data FROM messages ORDER BY id"
    damaged = 0
    for number, stamp_ns, data in connection.execute(query):
        name = names.get(number)
        if name not in wanted:
            continue
        if isinstance(stamp_ns, int) and isinstance(data, bytes):
            try:
                bag.take(str(name), stamp_ns, data, budget)
                continue
            except zstandard.ZstdError:
                pass
        damaged += 1
    if damaged:
        bag.notices.append(f"{bag.path}: {damaged} damaged messages were left out")


def _read_mcap(bag: Bag, file: Path, wanted: set[str], budget: Budget) -> None:
    schemas: dict[int, rec.Schema] = {}
    names: dict[int, str] = {}
    with file.open("rb") as opened:
        if opened.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            raise LogError(f"{bag.path}: not an MCAP file; is its beginning missing?")
        for offset, opcode, body in records_of(opened):
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                return
            try:
                for record in _opened(opcode, body, budget):
                    if isinstance(record, rec.Schema):
                        schemas[record.id] = record
                    elif isinstance(record, rec.Channel):
                        schema = schemas.get(record.schema_id) or rec.Schema(
                            0, b"", "", ""
                        )
                        names[record.id] = record.topic
                        bag.topics[record.topic] = Topic(
                            schema.name,
                            schema.data.decode(errors="replace"),
                            schema.encoding,
                            record.message_encoding,
                        )
                    elif (
                        isinstance(record, rec.Message)
                        and (name := names.get(record.channel_id)) in wanted
                    ):
                        bag.take(str(name), record.log_time, record.data, budget)
            except (*_BROKEN, zstandard.ZstdError) as error:
                why = (
                    str(error)
                    if isinstance(error, ValueError)
                    else type(error).__name__
                )
                bag.notices.append(
                    f"{bag.path}: the record at byte {offset} is damaged ({why:.80});"
                    " everything before it was read"
                )
                return
    bag.notices.append(f"{bag.path}: {_TORN}")


_READ: Mapping[int, Callable[[ReadDataStream], rec.McapRecord]] = {
    Opcode.SCHEMA: rec.Schema.read,
    Opcode.CHANNEL: rec.Channel.read,
}


def _opened(opcode: int, body: bytes, budget: Budget) -> Iterator[rec.McapRecord]:
    """Yield a record, or those inside a chunk."""
    stream = ReadDataStream(BytesIO(body))
    if opcode == Opcode.CHUNK:
        inside = BytesIO(budget.unpack(rec.Chunk.read(stream)))
        for _, inner, part in records_of(cast("BinaryIO", inside)):
            if inner != Opcode.CHUNK:
                yield from _opened(inner, part, budget)
    elif opcode == Opcode.MESSAGE:
        yield rec.Message.read(stream, len(body))
    elif opcode in _READ:
        yield _READ[opcode](stream)

"""The messages of ROS 2 bags, sqlite3 and MCAP, read without ROS: torn ones as far as they go."""

import sqlite3
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

import zstandard
from mcap import records as rec
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC

from hilserver.errors import LogError
from hilserver.logs.mcap_reader import records_of

SUFFIXES = (".db3", ".mcap")
_BROKEN = (ValueError, KeyError, struct.error, zlib.error, EndOfFile, McapError)
_TORN = "the recorder did not close the file; its contents were read"


@dataclass(frozen=True, slots=True)
class Topic:
    """What a bag says of a topic; the definition is empty where it holds none."""

    type: str
    definition: str = ""
    encoding: str = "ros2msg"


@dataclass
class Bag:
    """The messages of one file.

    Attributes
    ----------
    topics : mapping of str to Topic
    messages : mapping of str to list of (int, bytes)
        Stamp of reception [ns] and CDR, of the topics that were asked for.
    """

    path: Path
    topics: dict[str, Topic] = field(default_factory=dict)
    messages: dict[str, list[tuple[int, bytes]]] = field(default_factory=dict)
    notices: list[str] = field(default_factory=list)


def is_bag(path: Path) -> bool:
    """Return whether a path looks like a bag."""
    return path.suffix in SUFFIXES or path.is_dir()


def read_messages(path: Path, wanted: set[str]) -> list[Bag]:
    """Read the messages of some topics, one `Bag` for each file.

    Parameters
    ----------
    path : Path
        A file, or the folder with all files of the bag.

    Raises
    ------
    LogError
        One sentence that names file and remedy.
    """
    return [_read_file(file, wanted) for file in _files(path)]


def _files(path: Path) -> Sequence[Path]:
    if not path.is_dir():
        return [path]
    files = sorted(file for file in path.iterdir() if file.suffix in SUFFIXES)
    if not files:
        raise LogError(f"{path}: is a folder without a bag (.db3 or .mcap); name the log itself")
    return files


def _read_file(path: Path, wanted: set[str]) -> Bag:
    return _read_sqlite(path, wanted) if path.suffix == ".db3" else _read_mcap(path, wanted)


def _read_sqlite(path: Path, wanted: set[str]) -> Bag:
    bag = Bag(path)
    path.open("rb").close()  # the system's own words for what cannot be opened
    connection = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)
    try:
        _take_sqlite(connection, bag, wanted)
    except sqlite3.Error as error:
        if not any(bag.messages.values()):
            raise LogError(
                f"{path}: is no readable bag ({error}); copy it again, or run 'ros2 bag reindex'"
            ) from None
        bag.notices.append(f"{path}: is damaged ({error}); everything before that was read")
    finally:
        connection.close()
    return bag


def _take_sqlite(connection: sqlite3.Connection, bag: Bag, wanted: set[str]) -> None:
    tables = {row[0] for row in connection.execute("SELECT name FROM sqlite_master")}
    definitions: dict[str, tuple[str, str]] = {}
    if "message_definitions" in tables:
        query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        definitions = {row[0]: (row[2], row[1]) for row in connection.execute(query)}
    names = {}
    for number, name, kind in connection.execute("SELECT id, name, type FROM topics"):
        bag.topics[name] = Topic(kind, *definitions.get(kind, ()))
        names[number] = name
    query = "SELECT topic_id, timestamp, data FROM messages ORDER BY id"
    for number, stamp_ns, data in connection.execute(query):
        name = names.get(number)
        if name in wanted:
            bag.messages.setdefault(name, []).append((stamp_ns, data))


def _read_mcap(path: Path, wanted: set[str]) -> Bag:
    bag = Bag(path)
    schemas: dict[int, rec.Schema] = {}
    names: dict[int, str] = {}
    ended = False
    with path.open("rb") as file:
        if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            raise LogError(f"{path}: is not an MCAP file; is its beginning missing?")
        for offset, opcode, body in records_of(file):
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                ended = True
                break
            try:
                for record in _opened(opcode, body):
                    _take_mcap(record, bag, wanted, schemas, names)
            except (*_BROKEN, zstandard.ZstdError) as error:
                bag.notices.append(
                    f"{path}: the record at byte {offset} is damaged"
                    f" ({type(error).__name__}); everything before it was read"
                )
                return bag
    if not ended:
        bag.notices.append(f"{path}: {_TORN}")
    return bag


_READ: Mapping[int, Callable[[ReadDataStream], rec.McapRecord]] = {
    Opcode.SCHEMA: rec.Schema.read,
    Opcode.CHANNEL: rec.Channel.read,
}


def _opened(opcode: int, body: bytes) -> Iterator[rec.McapRecord]:
    """Yield a record, or those inside a chunk."""
    stream = ReadDataStream(BytesIO(body))
    if opcode == Opcode.CHUNK:
        yield from breakup_chunk(rec.Chunk.read(stream), validate_crc=True)
    elif opcode == Opcode.MESSAGE:
        yield rec.Message.read(stream, len(body))
    elif opcode in _READ:
        yield _READ[opcode](stream)


def _take_mcap(
    record: rec.McapRecord,
    bag: Bag,
    wanted: set[str],
    schemas: dict[int, rec.Schema],
    names: dict[int, str],
) -> None:
    if isinstance(record, rec.Schema):
        schemas[record.id] = record
    elif isinstance(record, rec.Channel):
        schema = schemas.get(record.schema_id)
        names[record.id] = record.topic
        bag.topics[record.topic] = (
            Topic("") if schema is None
            else Topic(schema.name, schema.data.decode(), schema.encoding)
        )  # fmt: skip
    elif isinstance(record, rec.Message) and (name := names.get(record.channel_id)) in wanted:
        bag.messages.setdefault(str(name), []).append((record.log_time, record.data))

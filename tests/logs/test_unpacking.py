"""Small files that become large ones: refused before the memory or the time is gone."""

import io
import resource
import sqlite3
import time
from contextlib import contextmanager
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from hilserver.errors import LogError
from hilserver.logs import unpacking
from hilserver.logs.bag_messages import read_messages
from hilserver.logs.mcap_reader import read_mcap
from hilserver.logs.mcap_writer import record_dtype
from hilserver.logs.writing import open_writer
from hilserver.measured.parquet import read_parquet
from tests.logs.samples import batch_of, ramp, run_of
from tests.measured.samples import bag_file, write_bag

TOPIC = "/iotbot/rpm"
MB = 1 << 20


@contextmanager
def bounded(mb, seconds=10.0):
    """Let nothing here take more memory than this."""
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (now + mb * MB, hard))
    begin = time.process_time()
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
    assert time.process_time() - begin < seconds


def packed(n_bytes, content_size=True):
    """Zeros as one frame of zstd."""
    out, piece = io.BytesIO(), bytes(MB)
    packer = zstandard.ZstdCompressor(write_content_size=content_size)
    size = n_bytes if content_size else -1
    with packer.stream_writer(out, size=size, closefd=False) as stream:
        for _ in range(n_bytes // MB):
            stream.write(piece)
    return out.getvalue()


def chunk(compression, declared, data):
    """A chunk record of MCAP."""
    name = compression.encode()
    body = bytes(16) + declared.to_bytes(8, "little") + bytes(4)
    body += (
        len(name).to_bytes(4, "little") + name + len(data).to_bytes(8, "little") + data
    )
    return b"\x06" + len(body).to_bytes(8, "little") + body


def mcap_with(path, *records):
    """A bag of ten messages with such records behind them."""
    with path.open("wb") as file:
        writer = McapWriter(file, compression=CompressionType.NONE, use_chunking=False)
        writer.start(profile="ros2")
        channel = writer.register_channel(TOPIC, "json", 0)
        for i in range(10):
            writer.add_message(channel, i, b"{}", i)
    whole = path.read_bytes()
    path.write_bytes(whole + b"".join(records))
    return path


@pytest.mark.parametrize(
    ("compression", "data"),
    [
        ("zstd", packed(1024 * MB)),
        ("zstd", packed(1024 * MB, content_size=False)),
        ("lz4", lz4.frame.compress(bytes(512 * MB))),
        ("", bytes(4000)),
    ],
)
def test_a_chunk_that_holds_more_than_it_declares_ends_the_reading(
    tmp_path, compression, data
):
    path = mcap_with(tmp_path / "a.mcap", chunk(compression, 100, data))
    with bounded(300):
        (bag,) = read_messages(path, {TOPIC})
    assert len(bag.messages[TOPIC]) == 10
    assert "does not have the size that it declares" in bag.notices[0]


def recording_with(path, *records):
    """A recording of ours that was cut off, with such records behind it."""
    writer = open_writer(path, run_of(), range(4))
    writer.write(batch_of(ramp(10)))
    writer.flush()
    whole = path.read_bytes()
    writer.close()
    path.write_bytes(whole + b"".join(records))
    return path


@pytest.mark.parametrize(
    ("make", "read"),
    [
        (mcap_with, lambda path: read_messages(path, {TOPIC})),
        (recording_with, read_mcap),
    ],
)
def test_what_a_file_unpacks_to_in_all_is_bounded(tmp_path, monkeypatch, make, read):
    monkeypatch.setattr(unpacking, "FREE_BYTES", 16 * MB)
    monkeypatch.setattr(unpacking, "RATIO", 100)
    records = np.zeros(4 * MB // record_dtype(4).itemsize, dtype=record_dtype(4))
    records["opcode"] = Opcode.MESSAGE
    records["length"] = record_dtype(4).itemsize - 9
    data = zstandard.ZstdCompressor().compress(records.tobytes())
    path = make(tmp_path / "a.mcap", *[chunk("zstd", records.nbytes, data)] * 20)
    with (
        bounded(200),
        pytest.raises(LogError, match="expand to far more than a recording would"),
    ):
        read(path)


def test_a_chunk_that_declares_too_much_is_refused(tmp_path):
    path = mcap_with(tmp_path / "a.mcap", chunk("zstd", 1 << 40, packed(MB)))
    with bounded(200), pytest.raises(LogError, match="expand to far more"):
        read_messages(path, {TOPIC})


def test_a_record_that_is_longer_than_its_file_ends_it(tmp_path):
    path = mcap_with(
        tmp_path / "a.mcap", b"\x06" + (1 << 32).to_bytes(8, "little") + b"x"
    )
    with bounded(100):
        assert len(read_messages(path, {TOPIC})[0].messages[TOPIC]) == 10


def test_a_packed_file_is_bounded_too(tmp_path, monkeypatch):
    monkeypatch.setattr(unpacking, "FREE_BYTES", 16 * MB)
    path = tmp_path / "a.db3.zstd"
    path.write_bytes(packed(1024 * MB))
    with bounded(200), pytest.raises(LogError, match="expand to far more"):
        read_messages(path, {TOPIC})
    path.write_bytes(b"hello")
    with pytest.raises(LogError, match="cannot be decompressed"):
        read_messages(path, {TOPIC})


TABLES = """
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
INSERT INTO topics VALUES (1, '/iotbot/rpm', 'a/msg/B', 'cdr');
"""
ENDLESS = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) SELECT"
MESSAGES = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data"


@pytest.mark.parametrize(
    ("script", "complaint"),
    [
        (
            f"CREATE VIEW messages AS {ENDLESS} x id, 1 topic_id, x timestamp, '' data FROM c;",
            "no table messages",
        ),
        (
            f"{MESSAGES} BLOB AS (zeroblob(900000000)));"
            "INSERT INTO messages(topic_id, timestamp) VALUES (1, 1);",
            "too big",
        ),
        (
            f"{MESSAGES} BLOB); INSERT INTO messages VALUES (1, 1, 1, zeroblob(300000000));",
            "too big",
        ),
        (
            f"{MESSAGES}_ BLOB); CREATE VIEW data AS {ENDLESS} x FROM c;"
            "CREATE VIRTUAL TABLE message_definitions USING fts5(topic_type);",
            "no such column",
        ),
    ],
)
def test_views_that_never_end_and_giant_blobs_are_refused(tmp_path, script, complaint):
    path = tmp_path / "a.db3"
    connection = sqlite3.connect(path)
    connection.executescript(TABLES + script)
    connection.commit()
    connection.close()
    with (
        bounded(500),
        pytest.raises(LogError, match=f"not a readable bag .*{complaint}"),
    ):
        read_messages(path, {TOPIC})


def test_a_type_that_is_none_is_a_damaged_message(tmp_path):
    path = bag_file(write_bag(tmp_path / "bag"))
    connection = sqlite3.connect(path)
    connection.execute("UPDATE messages SET data = 'text' WHERE id = 3")
    connection.execute("UPDATE messages SET timestamp = 'late' WHERE id = 4")
    connection.commit()
    connection.close()
    (bag,) = read_messages(path, {TOPIC})
    assert len(bag.messages[TOPIC]) == 98
    assert "2 damaged messages were left out" in bag.notices[0]


def test_many_small_messages_that_each_become_large(tmp_path, monkeypatch):
    monkeypatch.setattr(unpacking, "FREE_BYTES", 16 * MB)
    path = bag_file(write_bag(tmp_path / "bag"))
    connection = sqlite3.connect(path)
    connection.execute("UPDATE messages SET data = ?", (packed(4 * MB),))
    connection.commit()
    connection.close()
    with bounded(200), pytest.raises(LogError, match="expand to far more"):
        read_messages(path, {TOPIC})


def test_what_stays_in_memory_is_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(unpacking, "KEPT_BYTES", 1000)
    with pytest.raises(LogError, match="its mapped topics contain more than"):
        read_messages(write_bag(tmp_path / "bag"), {TOPIC})


def test_a_parquet_file_of_many_equal_numbers(tmp_path, monkeypatch):
    pa = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    monkeypatch.setattr(unpacking, "FREE_BYTES", 16 * MB)
    parquet.write_table(pa.table({"t_s": np.zeros(10_000_000)}), tmp_path / "a.parquet")
    with bounded(200), pytest.raises(LogError, match="expand to far more"):
        read_parquet(tmp_path / "a.parquet")


def test_a_recording_of_ours_at_rest_is_far_from_the_bound():
    """What packs best: the same numbers in every frame, and ticks that count."""
    frame = bytes(1400)
    frames = b"".join(i.to_bytes(8, "little") * 3 + frame for i in range(4000))
    small = len(zstandard.ZstdCompressor().compress(frames))
    assert len(frames) / small < unpacking.RATIO

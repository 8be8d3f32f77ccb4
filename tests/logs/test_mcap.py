"""MCAP: foreign readers open it, every cut through the file leaves what stood before the cut."""

import contextlib
import errno
import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from hilserver.errors import LogError
from hilserver.logs import RecordedState, open_writer, read_log
from hilserver.logs.message import make_layout
from tests.logs.samples import NAMES, batch_of, ramp, run_of

N_CHUNKS, CHUNK_FRAMES = 5, 20
# the first record after those that a reader needs
CONFIG, ATTACHMENT_HEAD = b"config.yaml", 29
BAD_WAITING = 0x80320000


def written(path):
    writer = open_writer(
        path, run_of(), range(len(NAMES)), utc_minus_monotonic_ns=10**18
    )
    writer.add_state(RecordedState(0, 0, np.arange(3)))
    for i in range(N_CHUNKS):
        first = i * CHUNK_FRAMES
        writer.write(batch_of(ramp(CHUNK_FRAMES, first), first=first))
        writer.flush()
    writer.add_state(RecordedState(2, 50, np.arange(3)))
    writer.close()
    return path


def test_what_was_written_comes_back(tmp_path):
    log = read_log(written(tmp_path / "a.mcap"))
    n = N_CHUNKS * CHUNK_FRAMES
    for slot, name in enumerate(NAMES):
        assert np.array_equal(log.columns[name], ramp(n)[:, slot])
    assert log.ticks(1_000_000).tolist() == list(range(n))
    assert [(s.segment, s.tick) for s in log.states] == [(0, 0), (2, 50)]
    run = run_of()
    assert {key: log.run[key] for key in run} == run
    assert not log.notices


@pytest.mark.parametrize("number", [errno.EIO, errno.ENOSPC])
def test_only_a_full_disk_gives_up_frames_for_the_index(tmp_path, monkeypatch, number):
    write, size = os.write, written(tmp_path / "whole.mcap").stat().st_size

    def failing(fd, data):
        if os.fstat(fd).st_size + len(data) > size - 10:
            raise OSError(number, os.strerror(number))
        return write(fd, data)

    monkeypatch.setattr(os, "write", failing)
    with contextlib.suppress(OSError):
        written(tmp_path / "run.mcap")
    dropped = 1 if number == errno.ENOSPC else 0
    log = read_log(tmp_path / "run.mcap")
    assert len(log) == (N_CHUNKS - dropped) * CHUNK_FRAMES


def test_a_foreign_reader_finds_signals_by_their_names(tmp_path):
    with written(tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(
            file, validate_crcs=True, decoder_factories=[DecoderFactory()]
        )
        summary = reader.get_summary()
        assert summary.statistics.message_count == N_CHUNKS * CHUNK_FRAMES
        assert len(summary.chunk_indexes) == N_CHUNKS
        messages = list(reader.iter_decoded_messages())
        assert len(messages) == N_CHUNKS * CHUNK_FRAMES
        _, channel, message, decoded = messages[30]
        assert channel.topic == "/hilserver/frame"
        assert message.log_time == 10**18 + 30 * 1_000_000 + 7
        assert decoded.frame.tick == 30
        assert decoded.wheel.fl.speed_rpm == 10.0
        assert decoded.internal.command == -30.0
        assert len(decoded.status) == len(NAMES)
        attachments = {a.name: a.data for a in reader.iter_attachments()}
        assert attachments["config.yaml"] == b"plant: {}\n"
        assert {m.name for m in reader.iter_metadata()} == {"hilserver"}


@settings(max_examples=60, deadline=None)
@given(st.floats(0, 1))
def test_a_cut_anywhere_leaves_the_whole_chunks_before_it(tmp_path_factory, share):
    path = written(tmp_path_factory.getbasetemp() / "cut.mcap")
    whole = path.read_bytes()
    cut = round(share * len(whole))
    path.write_bytes(whole[:cut])
    if cut < whole.index(CONFIG) - ATTACHMENT_HEAD:
        with pytest.raises(
            LogError, match=r"(not an MCAP file|contains no hilserver recording)"
        ):
            read_log(path)
        return
    log = read_log(path)
    starts = [i for i in range(len(whole)) if whole.startswith(b"zstd", i)]
    chunks_begun = sum(start < cut for start in starts[:N_CHUNKS])
    assert len(log) in ((chunks_begun - 1) * CHUNK_FRAMES, chunks_begun * CHUNK_FRAMES)
    assert np.array_equal(log.columns["sim.tick"], np.arange(len(log)))
    if cut < starts[N_CHUNKS - 1]:
        assert "did not close the file" in log.notices[0]


def test_a_changed_byte_in_a_chunk_is_noticed(tmp_path):
    path = written(tmp_path / "a.mcap")
    data = bytearray(path.read_bytes())
    data[data.index(b"zstd") + 40] ^= 0x10
    path.write_bytes(data)
    with pytest.raises(
        LogError, match=r"the record at byte \d+ is damaged; truncate the file there"
    ):
        read_log(path)


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("base_period_ns", None, "base_period_ns: "),
        ("base_period_ns", 0, "base_period_ns: "),
        ("base_period_ns", float("inf"), "base_period_ns: "),
        ("signals", [{"name": 1}], "signals.0.name: "),
        ("layout", "x", "is damaged"),
        ("identity", [1], "identity: "),
        ("not_replayable", 7, "not_replayable: "),
    ],
)
@pytest.mark.parametrize("suffix", [".mcap", ".csv"])
def test_a_run_that_cannot_be_is_a_sentence(tmp_path, key, value, says, suffix):
    path = tmp_path / f"a{suffix}"
    writer = open_writer(path, run_of(), range(len(NAMES)))
    writer.write(batch_of(ramp(5)))
    writer.tell(run_of() | {key: value})
    writer.close()
    with pytest.raises(
        LogError, match=says if suffix == ".mcap" else "is damaged; remove it"
    ):
        read_log(path)


def test_a_run_that_does_not_know_a_column_is_a_sentence(tmp_path):
    writer = open_writer(tmp_path / "a.mcap", run_of(), range(len(NAMES)))
    writer.write(batch_of(ramp(5)))
    writer.tell(run_of() | {"signals": run_of()["signals"][1:]})
    writer.close()
    with pytest.raises(
        LogError, match=r"does not list the signal 'wheel\.fl\.setpoint_rpm'"
    ):
        read_log(tmp_path / "a.mcap")


@pytest.mark.parametrize("text", ["[" * 5000 + "]" * 5000, "{", "1"])
def test_metadata_that_is_no_json_is_a_damaged_record(tmp_path, text):
    path = tmp_path / "a.mcap"
    writer = open_writer(path, run_of(), range(len(NAMES)))
    writer.write(batch_of(ramp(5)))
    writer.tell(run_of() | {"audit": text, "signals": text})
    writer.close()
    with pytest.raises(LogError, match=r"is damaged"):
        read_log(path)


def test_lost_frames_are_said_and_bad_values_are_no_samples(tmp_path):
    writer = open_writer(tmp_path / "a.mcap", run_of(), range(len(NAMES)))
    writer.write(batch_of(ramp(5), status=[[BAD_WAITING, 0, 0, 0]] * 5))
    writer.write(batch_of(ramp(5), first=12))
    writer.close()
    log = read_log(tmp_path / "a.mcap")
    assert "7 frames were lost" in log.notices[0]
    assert (
        np.isnan(log.columns["wheel.fl.setpoint_rpm"]).tolist()
        == [True] * 5 + [False] * 5
    )
    assert log.status["wheel.fl.setpoint_rpm"][0] == BAD_WAITING


@pytest.mark.parametrize("data", [b"", b"PK\x03\x04" * 10, b"\x89MCAP0\r\n"])
def test_what_is_no_recording_is_said(tmp_path, data):
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    with pytest.raises(
        LogError, match=r"a\.mcap: (not an MCAP file|contains no hilserver recording)"
    ):
        read_log(path)


def test_a_signal_and_a_group_of_the_same_name_get_along():
    layout = make_layout(
        ["frame.a", "status.b", "arm.length", "arm.length.left", "top"]
    )
    fields = [line.split()[1] for line in layout.schema.splitlines() if " " in line]
    assert {"frame", "frame_", "status", "status_", "length", "length_"} <= set(fields)
    assert sorted(layout.names) == [
        "arm.length",
        "arm.length.left",
        "frame.a",
        "status.b",
        "top",
    ]

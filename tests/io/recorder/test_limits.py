"""A recording has a largest size, and leaves room on the disk."""

import errno
import shutil
from collections import namedtuple

import pytest

from hilserver.errors import FailedError
from hilserver.io.recorder.series import FileSeries, Settings
from hilserver.logs.writer import WholeFile

Usage = namedtuple("Usage", "total used free")
Writer = namedtuple("Writer", "n_bytes")
SIGNAL = {"name": "sim.tick", "unit": "1", "slots": [0], "direction": "out"}


def test_it_ends_at_its_size(tmp_path):
    series = FileSeries(Settings(tmp_path / "run.mcap", max_bytes=1e6))
    series._opened = 1
    series.check(Writer(999_999))
    with pytest.raises(FailedError, match=r"has ended at 1 MB, its limit.*--max-mb"):
        series.check(Writer(1_000_000))


@pytest.mark.parametrize(("keep", "ends"), [(None, True), (3, False)])
def test_the_files_of_a_rotation_count_together(tmp_path, keep, ends):
    series = FileSeries(
        Settings(
            tmp_path / "run.mcap", rotate_bytes=2_000_000, keep=keep, max_bytes=9e6
        )
    )
    series._opened = 5
    if ends:
        with pytest.raises(FailedError, match="its limit"):
            series.check(Writer(1_500_000))
    else:
        series.check(Writer(1_500_000))


def test_it_ends_before_the_disk_is_full(tmp_path, monkeypatch):
    monkeypatch.setattr(
        shutil, "disk_usage", lambda _: Usage(10**10, 10**10 - 10**8, 10**8)
    )
    series = FileSeries(Settings(tmp_path / "run.mcap", keep_free_bytes=2e8))
    with pytest.raises(FailedError, match="100 MB are left on the disk"):
        series.check(Writer(0))


@pytest.mark.parametrize("name", ["run.mcap", "run.csv"])
def test_what_cannot_begin_leaves_no_file(tmp_path, monkeypatch, name):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(WholeFile, "append", full)
    run = {
        "schema": 1,
        "base_period_ns": 1_000_000,
        "configuration": None,
        "signals": [SIGNAL],
    }
    with pytest.raises(FailedError, match="no space left"):
        FileSeries(Settings(tmp_path / name)).open(run, [0], 0)
    assert list(tmp_path.iterdir()) == []


def test_on_a_disk_that_is_nearly_full_nothing_begins_and_nothing_is_lost(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(
        shutil, "disk_usage", lambda _: Usage(10**10, 10**10 - 10**8, 10**8)
    )
    before = tmp_path / "run.mcap"
    before.write_bytes(b"of yesterday")
    series = FileSeries(Settings(before, keep_free_bytes=2e8))
    with pytest.raises(
        FailedError, match="the recording cannot begin, as 100 MB are left"
    ):
        series.open({}, [0], 0)
    assert before.read_bytes() == b"of yesterday"

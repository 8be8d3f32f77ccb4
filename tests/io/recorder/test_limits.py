"""A recording has a largest size, and leaves room on the disk."""

import shutil
from collections import namedtuple

import pytest

from hilserver.errors import FailedError
from hilserver.io.recorder.series import FileSeries, Limits

Usage = namedtuple("Usage", "total used free")
Writer = namedtuple("Writer", "n_bytes")


def test_it_ends_at_its_size(tmp_path):
    series = FileSeries(tmp_path / "run.mcap", limits=Limits(max_bytes=1e6))
    series._opened = 1
    series.check(Writer(999_999))
    with pytest.raises(FailedError, match=r"has ended at 1 MB, its limit.*--max-mb"):
        series.check(Writer(1_000_000))


@pytest.mark.parametrize(("keep", "ends"), [(None, True), (3, False)])
def test_the_files_of_a_rotation_count_together(tmp_path, keep, ends):
    limits = Limits(max_bytes=9e6)
    series = FileSeries(tmp_path / "run.mcap", rotate_bytes=2_000_000, keep=keep, limits=limits)
    series._opened = 5
    if ends:
        with pytest.raises(FailedError, match="its limit"):
            series.check(Writer(1_500_000))
    else:
        series.check(Writer(1_500_000))


def test_it_ends_before_the_disk_is_full(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(10**10, 10**10 - 10**8, 10**8))
    series = FileSeries(tmp_path / "run.mcap", limits=Limits(keep_free_bytes=2e8))
    with pytest.raises(FailedError, match="100 MB are left on the disk"):
        series.check(Writer(0))

"""The writing thread: a slow disk costs frames, counted; a full one ends it; files take turns."""

import errno
import threading

import pytest

from hilserver.io.recorder import write_behind
from hilserver.io.recorder.series import FileSeries, Settings
from hilserver.io.recorder.write_behind import WriteBehind
from hilserver.logs import read_log
from tests.logs.samples import NAMES, batch_of, ramp, run_of


class SlowDisk:
    """Takes nothing until it is let go; the only part here that is not real."""

    n_bytes = 0

    def __init__(self):
        self.go = threading.Event()
        self.busy = threading.Event()
        self.batches = []

    def write(self, batch):
        self.busy.set()
        assert self.go.wait(120)
        self.batches.append(batch)

    def flush(self): ...
    def sync(self): ...
    def close(self): ...


class FullDisk(SlowDisk):
    closed = False

    def write(self, batch):
        raise OSError(errno.ENOSPC, "No space left on device")

    def close(self):
        self.closed = True


def writing(writer, buffer_bytes=10**6):
    return WriteBehind(lambda: writer, lambda _: False, lambda: None, buffer_bytes)


def test_what_a_slow_disk_does_not_take_is_dropped_and_counted():
    disk = SlowDisk()
    batch = batch_of(ramp(10))
    behind = writing(disk, buffer_bytes=3 * batch.frames.n_bytes)
    assert behind.put(batch)
    assert disk.busy.wait(120)
    assert [behind.put(batch) for _ in range(5)] == [True, True, False, False, False]
    assert behind.dropped == 30
    disk.go.set()
    assert behind.close(10)
    assert len(disk.batches) == 3
    assert behind.written == 30
    assert behind.put(batch)  # there is room again


def test_a_disk_that_never_answers_does_not_hold_the_end_up():
    disk = SlowDisk()
    behind = writing(disk)
    behind.put(batch_of(ramp(10)))
    assert not behind.close(0.05)
    disk.go.set()


def test_a_disk_that_never_opens_a_file_is_given_up(monkeypatch):
    """And a file that is opened after all is completed, with nothing in it."""
    monkeypatch.setattr(write_behind, "OPEN_WITHIN_S", 0.05)
    disk = SlowDisk()
    closed = threading.Event()
    disk.close = closed.set

    def open_late():
        assert disk.go.wait(120)
        return disk

    with pytest.raises(TimeoutError, match=r"opened for 0\.05 s"):
        WriteBehind(open_late, lambda _: False, lambda: None, 10**6)
    disk.go.set()
    assert closed.wait(120)
    assert not disk.batches


def test_a_full_disk_ends_the_writing_and_closes_the_file():
    disk = FullDisk()
    behind = writing(disk)
    behind.put(batch_of(ramp(10)))
    assert behind.close(10)
    assert behind.error.errno == errno.ENOSPC
    assert disk.closed


@pytest.mark.parametrize("suffix", ["csv", "mcap"])
def test_rotation_begins_new_files_and_keeps_the_newest(tmp_path, suffix):
    series = FileSeries(
        Settings(tmp_path / f"run.{suffix}", rotate_bytes=10_000, keep=3)
    )
    new_files = []
    behind = WriteBehind(
        lambda: series.open(run_of(), range(len(NAMES)), 0),
        series.is_full,
        lambda: new_files.append(series.current),
        10**8,
    )
    for i in range(40):
        behind.put(batch_of(ramp(100, first=100 * i), first=100 * i))
    assert behind.close(20)
    files = sorted(tmp_path.glob(f"run_*.{suffix}"))
    assert len(new_files) >= 3
    assert files == new_files[-3:]
    logs = [read_log(path) for path in files]
    ticks = [tick for log in logs for tick in log.ticks(1_000_000).tolist()]
    assert ticks == list(range(ticks[0], 4000))
    beside = sorted(path.name for path in tmp_path.glob("*.json"))
    assert beside == (
        [f"{path.name}.meta.json" for path in files] if suffix == "csv" else []
    )
    following = FileSeries(Settings(tmp_path / f"run.{suffix}", rotate_bytes=10_000))
    following.open(run_of(), range(len(NAMES)), 0).close()
    assert int(following.current.stem[-4:]) == int(files[-1].stem[-4:]) + 1

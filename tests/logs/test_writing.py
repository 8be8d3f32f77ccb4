"""Two that record into one file: the second is refused, and the first loses nothing."""

import pytest

from hilserver.errors import FailedError
from hilserver.logs import open_writer, read_log
from hilserver.logs.csv_writer import meta_path
from tests.logs.samples import NAMES, batch_of, ramp, run_of


@pytest.mark.parametrize("suffix", [".csv", ".mcap"])
def test_a_file_that_is_being_written_is_refused(tmp_path, suffix):
    path, slots = tmp_path / f"run{suffix}", range(len(NAMES))
    first = open_writer(path, run_of(), slots)
    first.write(batch_of(ramp(10)))
    beside = meta_path(path).read_bytes() if suffix == ".csv" else b""
    with pytest.raises(
        FailedError, match="another program is writing to it; choose another name"
    ):
        open_writer(path, {**run_of(), "seed": 99}, slots)
    if beside:
        assert meta_path(path).read_bytes() == beside
    first.close()
    assert len(read_log(path)) == 10


@pytest.mark.parametrize("suffix", [".csv", ".mcap"])
def test_one_that_is_complete_is_written_anew(tmp_path, suffix):
    path, slots = tmp_path / f"run{suffix}", range(len(NAMES))
    for n in (10, 3):
        writer = open_writer(path, run_of(), slots)
        writer.write(batch_of(ramp(n)))
        writer.close()
        assert len(read_log(path)) == n

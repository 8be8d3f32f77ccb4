"""The recorder as a process beside a real daemon: killed, stopped, out of space, left alone."""

import resource
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from hilserver.image import ImageReader
from hilserver.logs import read_log
from tests.helpers.daemons import (
    finish,
    recorder,
    running_daemon,
    start_recorder,
    wait_for_start,
)

PERIOD_NS = 1_000_000
FILE_LIMIT = 400_000


@pytest.fixture(scope="module")
def daemon(tmp_path_factory):
    with running_daemon(tmp_path_factory.mktemp("daemon")) as daemon:
        yield daemon


def latest_tick(daemon):
    return ImageReader.attach(daemon.image).latest().tick


def assert_gapless(log):
    ticks = log.ticks(PERIOD_NS)
    assert len(ticks) > 500
    assert (np.diff(ticks) == 1).all()
    assert np.array_equal(log.columns["sim.tick"], ticks)


def wait_until_it_grew(path, times):
    """The busy computer may not have given the recorder its first second yet."""
    sizes, end_s = set(), time.monotonic() + 100.0
    while len(sizes) <= times:
        assert time.monotonic() < end_s, "nothing is written"
        sizes.add(path.stat().st_size)
        time.sleep(0.05)


def test_five_times_kill_9_loses_at_most_the_last_second(daemon, tmp_path):
    names = ["a.mcap", "b.csv", "c.mcap", "d.csv", "e.mcap"]
    running = [
        (tmp_path / name, start_recorder(daemon, tmp_path / name)) for name in names
    ]
    for _, process in running:
        wait_for_start(process)
    for i, (path, process) in enumerate(running):
        wait_until_it_grew(path, times=3)
        time.sleep(0.5 + 0.137 * i)
        killed_at = latest_tick(daemon)
        process.send_signal(signal.SIGKILL)
        finish(process)
        log = read_log(path)
        assert_gapless(log)
        assert killed_at - log.ticks(PERIOD_NS)[-1] <= 1000
        assert log.states, "a state to replay from"
        assert log.run["audit"]
        if path.suffix == ".mcap":
            assert "did not close the file" in log.notices[0]


def test_it_stops_when_asked_with_a_complete_file(daemon, tmp_path):
    path = tmp_path / "run.mcap"
    process = recorder(daemon, path)
    time.sleep(1.0)
    process.send_signal(signal.SIGTERM)
    code, text = finish(process)
    assert code == 0
    assert "frames in" in text
    assert "none lost" in text
    log = read_log(path)
    assert_gapless(log)
    assert not log.notices


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_bag_is_complete_when_it_is_asked_to_stop(daemon, tmp_path, storage):
    process = recorder(
        daemon, tmp_path / "bag", "--format", "bag", "--storage", storage
    )
    time.sleep(1.0)
    process.send_signal(signal.SIGTERM)
    code, _ = finish(process)
    assert code == 0
    log = read_log(tmp_path / "bag")
    assert_gapless(log)
    assert log.states, "a state to replay from"
    assert (tmp_path / "bag" / "metadata.yaml").is_file()
    code, text = finish(start_recorder(daemon, tmp_path / "bag", "--format", "bag"))
    assert code == 1
    assert "already exists" in text


def test_a_choice_of_signals_cannot_be_replayed_and_says_so(daemon, tmp_path):
    path = tmp_path / "run.csv"
    process = recorder(
        daemon, path, "--signals", "pose.*", "--signals", "sim.tick", "--duration=1"
    )
    code, text = finish(process)
    assert code == 0
    assert "without all inputs this recording cannot be replayed" in text
    assert list(read_log(path).columns) == [
        "pose.x_m",
        "pose.y_m",
        "pose.yaw_rad",
        "sim.tick",
    ]


def limit_file_size():
    resource.setrlimit(resource.RLIMIT_FSIZE, (FILE_LIMIT, FILE_LIMIT))


@pytest.mark.parametrize("name", ["run.mcap", "run.csv"])
def test_without_space_it_ends_with_one_sentence_and_a_readable_file(
    daemon, tmp_path, name
):
    path = tmp_path / name
    process = recorder(daemon, path, preexec_fn=limit_file_size)
    code, text = finish(process)
    assert code == 1
    assert len(text.splitlines()) == 1
    assert text.startswith(f"hilserver: {path}: recording ended: no space left; free")
    log = read_log(path)
    assert_gapless(log)
    assert not log.notices
    assert path.stat().st_size <= FILE_LIMIT


@pytest.mark.parametrize(
    ("code", "options", "complaint"),
    [
        (1, ["-o", "run.mcap", "--image", "nobody"], "no process image 'nobody'"),
        (
            2,
            ["-o", "run.txt", "--image", "nobody"],
            "run.txt: the name of a log must end in .mcap or .csv",
        ),
        (
            2,
            ["-o", "run.csv", "--keep", "2", "--image", "nobody"],
            "--keep counts the files of a",
        ),
    ],
)
def test_what_cannot_work_is_one_sentence(tmp_path, code, options, complaint):
    command = [sys.executable, "-m", "hilserver", "record", *options]
    run = subprocess.run(
        command, capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert run.returncode == code
    assert len(run.stderr.splitlines()) == 1
    assert complaint in run.stderr


def test_no_signal_and_no_folder_are_one_sentence(daemon, tmp_path):
    (tmp_path / "file").write_text("")
    for options, complaint in (
        (["-o", "run.csv", "--signals", "pos.*"], "no signal matches 'pos.*'"),
        (["-o", "file/run.csv"], "cannot be written"),
    ):
        command = [
            sys.executable,
            "-m",
            "hilserver",
            "record",
            "--image",
            daemon.image,
            *options,
        ]
        run = subprocess.run(
            command, capture_output=True, text=True, cwd=tmp_path, check=False
        )
        assert run.returncode == 1
        assert complaint in run.stderr
        assert "Traceback" not in run.stderr


def test_the_daemon_killed_the_recorder_completes_the_file(tmp_path):
    with running_daemon(tmp_path, "--record", "run.mcap") as own:
        beside = recorder(own, tmp_path / "beside.csv")
        time.sleep(1.5)
        killed_at = latest_tick(own)
        own.kill()
        code, text = finish(beside)
    assert code == 0
    assert "none lost" in text
    for _ in range(100):  # the daemon's own recorder is nobody's child any more
        time.sleep(0.1)
        if not read_log(tmp_path / "run.mcap").notices:
            break
    for name in ("run.mcap", "beside.csv"):
        log = read_log(tmp_path / name)
        assert not log.notices
        assert_gapless(log)
        assert log.ticks(PERIOD_NS)[-1] >= killed_at
    assert read_log(tmp_path / "run.mcap").ticks(PERIOD_NS)[0] == 0


def test_every_file_of_a_rotation_has_a_state_of_its_own(daemon, tmp_path):
    process = recorder(
        daemon, tmp_path / "run.csv", "--rotate-mb", "1", "--duration", "6"
    )
    code, text = finish(process)
    assert code == 0, text
    files = sorted(tmp_path.glob("run_*.csv"))
    assert len(files) >= 2
    logs = [read_log(path) for path in files]
    ticks = np.concatenate([log.ticks(PERIOD_NS) for log in logs])
    assert (np.diff(ticks) == 1).all(), "nothing is lost between two files"
    for log in logs[:-1]:
        first, last = log.ticks(PERIOD_NS)[[0, -1]]
        assert any(first <= state.tick <= last for state in log.states)

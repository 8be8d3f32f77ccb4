"""The process of a look: its share of the computer, and every way in which it can end."""

import json
import os
import select
import subprocess
import sys
import threading
import time

import pytest

from hilserver.config.root import Config, without_passwords
from hilserver.program import children
from hilserver.recalibration import process
from hilserver.recalibration.orders import JudgeOrder, Share, Todo
from hilserver.recalibration.windows import WindowNews, complete, first_file


def order(folder, path="window_0001.mcap"):
    config, share = without_passwords(Config()), Share(0, (), 2_000_000_000)
    todo = Todo(1, {}, look=True)
    return JudgeOrder(todo, str(folder / path), config, str(folder), {}, "", share)


@pytest.fixture
def worker(monkeypatch):
    def use(*words):
        monkeypatch.setattr(children, "python", lambda *_: list(words))

    return use


@pytest.mark.parametrize(
    ("script", "error"),
    [
        ("kill -9 $$", "its process was ended by SIGKILL"),
        (
            "echo first >&2; echo boom >&2; exit 3",
            "its process ended with exit code 3: boom",
        ),
        ("echo nonsense", "its process ended with exit code 0: no error message"),
        (
            'echo "{\\"measure\\": 3}"',
            "its process ended with exit code 0: no error message",
        ),
        ("exit 1", "its process ended with exit code 1: no error message"),
    ],
)
async def test_however_it_ends_there_is_a_sentence(tmp_path, worker, script, error):
    worker("sh", "-c", script)
    assert (await process.looked(order(tmp_path), tmp_path, 60.0)).error == error


async def test_one_that_takes_too_long_is_ended(tmp_path, worker):
    worker("sh", "-c", f"echo $$ > {tmp_path}/pid; exec sleep 1000")
    result = await process.looked(order(tmp_path), tmp_path, 1.0)
    assert result.error == "it took longer than 1 s and was stopped"
    pid = (tmp_path / "pid").read_text().strip()
    with pytest.raises(ProcessLookupError):
        os.kill(int(pid), 0)


@pytest.mark.parametrize("script", ["kill -9 $$", "echo nonsense"])
async def test_what_is_over_leaves_no_order(tmp_path, worker, script):
    worker("sh", "-c", script)
    await process.looked(order(tmp_path), tmp_path, 60.0)
    assert process.cut_short(tmp_path) is None


KILLED = """
import asyncio, os, sys
from dataclasses import replace
from pathlib import Path
from hilserver.program import children
from hilserver.recalibration import process
from tests.recalibration.test_process import LASTS, order
folder, pipe = Path(sys.argv[1]), sys.argv[2]
children.python = lambda *words: [sys.executable, "-c", LASTS, words[-1], pipe]
made = order(folder)
share = replace(made.share, parent=os.getpid())
made = replace(made, todo=replace(made.todo, window=7), share=share)
asyncio.run(process.looked(made, folder, 600.0))
"""
LASTS = """
import sys
from hilserver.recalibration import judging, worker
class OrderJudge:
    def __init__(self, order):
        open(sys.argv[2]).read()
judging.OrderJudge = OrderJudge
worker.main()
"""


def test_a_look_ends_with_a_daemon_that_is_killed_and_the_next_one_knows(tmp_path):
    """It reads a pipe that nobody writes into, as long as it lives."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    daemon = subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path), str(pipe)])
    try:
        writer = wait_for(lambda: reader_of(pipe))
    finally:
        daemon.kill()
        daemon.wait()
    wait_for(lambda: is_broken(writer))
    os.close(writer)
    assert process.cut_short(tmp_path) == 7
    assert process.cut_short(tmp_path) is None


def test_half_an_order_was_a_look_of_some_window(tmp_path):
    (tmp_path / process.ORDER).write_text('{"todo": {"win')
    assert process.cut_short(tmp_path) == 0


def wait_for(what, limit_s=60.0):
    end_s = time.monotonic() + limit_s
    while time.monotonic() < end_s:
        if found := what():
            return found
        time.sleep(0.02)
    raise AssertionError("it has not come")


def reader_of(pipe):
    """The writing end of a pipe, once somebody reads it."""
    try:
        return os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)
    except OSError:
        return None


def is_broken(writer):
    """Whether nobody reads a pipe any more."""
    poll = select.poll()
    poll.register(writer, select.POLLOUT)
    return any(event & select.POLLERR for _, event in poll.poll(0))


async def test_a_folder_that_is_gone_is_named(tmp_path):
    result = await process.looked(order(tmp_path), tmp_path / "gone", 60.0)
    assert "order.json: no such file" in result.error


async def test_a_window_that_is_gone_is_named(tmp_path):
    result = await process.looked(order(tmp_path), tmp_path, 600.0)
    assert "window_0001.mcap" in result.error


def test_it_takes_no_more_than_its_share():
    script = (
        "import json, os, resource; from hilserver.recalibration.orders import Share;"
        "from hilserver.recalibration.worker import take; before = os.nice(0);"
        "cores = sorted(os.sched_getaffinity(0)); take(Share(4, (cores[-1],), 10**9, 0));"
        "print(json.dumps([os.nice(0) - before, len(os.sched_getaffinity(0)),"
        " resource.getrlimit(resource.RLIMIT_DATA)[0]]))"
    )
    words = [sys.executable, "-c", script]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    nicer, cores, memory = json.loads(done.stdout)
    assert (cores, memory) == (1, 10**9)
    assert nicer >= 0  # nothing is nicer than 19


def test_its_session_is_lowered_with_it():
    """Where a process competes by its session, nothing else makes it yield."""
    write = "from pathlib import Path; Path('/proc/self/autogroup').write_text('4')"
    own = "from hilserver.recalibration.orders import Share; from hilserver.recalibration.worker"
    own += " import take; take(Share(4, (), 0, 0))"
    read = "; from pathlib import Path; print(Path('/proc/self/autogroup').read_text())"
    wanted, found = (
        subprocess.run(
            [sys.executable, "-c", script + read],
            capture_output=True,
            text=True,
            check=False,
            start_new_session=True,
        )
        for script in (write, own)
    )
    # this computer has none, or lets nobody write
    assert wanted.returncode != 0 or found.stdout.endswith(
        wanted.stdout.split()[-1] + "\n\n"
    )


def test_it_stays_off_the_core_of_the_pacing_thread(monkeypatch):
    """Of this thread, which is bound to one core while others are free."""
    me, before = threading.get_native_id(), os.sched_getaffinity(0)
    mine = min(before)
    try:
        os.sched_setaffinity(0, {mine})
        monkeypatch.setattr(
            process.os, "sched_getaffinity", lambda _: {mine, 1000, 1001}
        )
        assert process.other_cores(me, None) == (1000, 1001)
        assert process.other_cores(me, 1000) == (1000,)
        assert process.other_cores(0, None) == ()  # in virtual time nobody paces
        monkeypatch.setattr(process.os, "sched_getaffinity", lambda _: {mine})
        assert process.other_cores(me, None) == (mine,)
    finally:
        os.sched_setaffinity(0, before)


def test_the_newest_file_is_no_window_yet_and_none_comes_twice(tmp_path):
    def begin(number):
        first_file(tmp_path).with_name(f"window_{number:04d}.mcap").touch()

    begin(3)  # of an earlier run
    news = WindowNews(tmp_path)
    assert news.next() is None
    begin(4)
    assert news.next() is None
    begin(5)
    assert news.next().number == 4
    assert news.next() is None
    begin(6)
    begin(7)
    assert news.next().number == 6  # it was slow: the one before is too late
    assert [window.number for window in complete(tmp_path)] == [3, 4, 5, 6]

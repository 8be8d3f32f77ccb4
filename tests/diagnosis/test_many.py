"""Many logs: the same results from one process, two, and a Dask cluster."""

import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from hilserver.diagnosis.many import on_cluster
from hilserver.errors import FailedError
from hilserver.program.workers import in_processes

TASKS = [3, 1, 4, 1, 5]


def work(seed):
    """Something that depends on its task alone."""
    return float(np.random.default_rng(seed).normal(size=1000).sum())


def end(_seed):
    os.kill(os.getpid(), signal.SIGKILL)


def collected(results):
    found = dict(results)
    return [found[index] for index in range(len(TASKS))]


@pytest.fixture(scope="module")
def expected():
    return [work(seed) for seed in TASKS]


def test_one_process_and_two_give_the_same(expected):
    assert collected(in_processes(work, TASKS, 1)) == expected
    assert collected(in_processes(work, TASKS, 2)) == expected


def wait_forever(file):
    with Path(file).open("a") as out:
        out.write(f"{os.getpid()}\n")
    time.sleep(600.0)


def alive(pid):
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
        return stat.rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def campaign(folder, lines):
    """Start a program with two workers that wait; return it and their process ids."""
    file, script = folder / "pids", folder / "campaign.py"
    head = [
        "from hilserver.program.ending import ended_by_signals",
        "from hilserver.program.workers import in_processes",
        "from tests.diagnosis.test_many import wait_forever",
        f"tasks = [{str(file)!r}] * 40",
    ]
    script.write_text("\n".join([*head, *lines]))
    parent = subprocess.Popen(
        [sys.executable, str(script)], env=os.environ | {"PYTHONPATH": "."}
    )
    found = until(
        lambda: file.exists() and file.read_text().split(), lambda ids: len(ids) == 2
    )
    return parent, found


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_the_process_that_started_them(tmp_path, how):
    run = "if __name__ == '__main__': list(in_processes(wait_forever, tasks, 2))"
    parent, pids = campaign(tmp_path, [run])
    parent.send_signal(how)
    parent.wait(600)
    until(lambda: [pid for pid in pids if alive(pid)], lambda left: not left)


def test_a_campaign_that_is_stopped_ends_at_once(tmp_path):
    """Not after all that is queued."""
    run = [
        "if __name__ == '__main__':",
        "    with ended_by_signals():",
        "        list(in_processes(wait_forever, tasks, 2))",
    ]
    parent, pids = campaign(tmp_path, run)
    parent.send_signal(signal.SIGTERM)
    assert parent.wait(600) == 0
    until(lambda: [pid for pid in pids if alive(pid)], lambda left: not left)


def test_closing_the_results_ends_the_workers():
    with closing(in_processes(time.sleep, [0.0] + [600.0] * 6, 2)) as results:
        assert next(results) == (0, None)
    until(multiprocessing.active_children, lambda left: not left)


@pytest.mark.parametrize("is_closed", [False, True])
def test_no_thread_of_the_pool_is_left(is_closed):
    """One that is, writes to pipes that the interpreter has closed: "Bad file descriptor"."""
    before = set(threading.enumerate())
    with closing(in_processes(time.sleep, [0.0, 0.0, 0.0], 2)) as results:
        next(results) if is_closed else list(results)
    assert set(threading.enumerate()) <= before


def until(look, good, within_s=120.0):
    end = time.monotonic() + within_s
    while time.monotonic() < end:
        found = look()
        if found is not False and good(found):
            return found
        time.sleep(0.05)
    raise AssertionError(f"still {look()} after {within_s} s")


def test_a_worker_that_is_ended_is_a_sentence():
    with pytest.raises(FailedError, match="fewer --jobs"):
        list(in_processes(end, TASKS, 2))


@pytest.mark.filterwarnings("ignore")  # of the cluster's own making
def test_a_dask_cluster_gives_the_same(expected):
    distributed = pytest.importorskip("distributed")
    options = {
        "n_workers": 2,
        "threads_per_worker": 1,
        "dashboard_address": "127.0.0.1:0",
    }
    with distributed.LocalCluster(processes=True, **options) as cluster:
        assert collected(on_cluster(work, TASKS, cluster.scheduler_address)) == expected


@pytest.mark.filterwarnings("ignore")
def test_an_address_where_nobody_answers_is_a_sentence(monkeypatch):
    monkeypatch.setattr("hilserver.diagnosis.many.CONNECT_WITHIN_S", 1)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{probe.getsockname()[1]}"
    with pytest.raises(FailedError, match="no cluster answers"):
        list(on_cluster(work, TASKS, address))
    with pytest.raises(FailedError, match="no cluster answers"):
        list(on_cluster(work, TASKS, "nonsense://host:1"))

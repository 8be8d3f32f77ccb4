"""Many logs: the same results from one process, two, and a Dask cluster."""

import os
import signal
import socket

import numpy as np
import pytest

from hilserver.diagnosis.many import in_processes, on_cluster
from hilserver.errors import FailedError

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


def test_a_worker_that_is_ended_is_a_sentence():
    with pytest.raises(FailedError, match="fewer --jobs"):
        list(in_processes(end, TASKS, 2))


@pytest.mark.filterwarnings("ignore")  # of the cluster's own making
def test_a_dask_cluster_gives_the_same(expected):
    distributed = pytest.importorskip("distributed")
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
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

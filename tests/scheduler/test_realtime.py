"""Requests to the operating system: granted or refused, never silent."""

import os
import resource
import threading

import pytest

from hilserver.scheduler import realtime
from hilserver.scheduler.realtime import ProcessGrants, RealtimeSettings, request_for_this_thread


def in_thread(settings):
    answer = []

    def ask():
        answer.append((request_for_this_thread(settings), os.sched_getaffinity(0)))

    thread = threading.Thread(target=ask)
    thread.start()
    thread.join()
    return answer[0]


def test_core_and_slack_concern_the_thread_alone():
    before = os.sched_getaffinity(0)
    cpu = min(before)
    grants, affinity = in_thread(RealtimeSettings(priority=0, cpu=cpu))
    assert affinity == {cpu}
    assert os.sched_getaffinity(0) == before
    assert [(g.name, g.ok) for g in grants] == [("timer_slack", True), ("thread_core", True)]


def test_a_core_that_is_not_there_is_named():
    grants, _ = in_thread(RealtimeSettings(priority=0, cpu=4000))
    (core,) = (g for g in grants if g.name == "thread_core")
    assert not core.ok
    assert core.wanted == "core 4000"
    assert core.mend.startswith("choose one of")


def test_a_refused_priority_is_visible(monkeypatch):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    grants, _ = in_thread(RealtimeSettings(priority=70))
    (priority,) = (g for g in grants if g.name == "thread_priority")
    assert (priority.ok, priority.wanted) == (False, "SCHED_FIFO 70")
    assert priority.found == "Operation not permitted"
    assert "LimitRTPRIO=70" in priority.mend


def test_memory_is_not_locked_under_a_finite_limit_without_the_capability(monkeypatch):
    monkeypatch.setattr(realtime, "_has_capability", lambda number: False)
    monkeypatch.setattr(resource, "getrlimit", lambda which: (65536, 65536))
    grants = ProcessGrants(RealtimeSettings(hold_latency_target=False))
    (lock,) = grants.request()
    assert (lock.ok, lock.found) == (False, "limit 64 KiB")
    assert "LimitMEMLOCK" in lock.mend
    grants.release()


def test_latency_target_is_held_and_given_back(monkeypatch, tmp_path):
    device = tmp_path / "cpu_dma_latency"
    device.write_bytes(b"\xff" * 4)
    monkeypatch.setattr(realtime, "_LATENCY_TARGET", device)
    grants = ProcessGrants(RealtimeSettings(lock_memory=False))
    (target,) = grants.request()
    assert target.ok
    assert device.read_bytes() == b"\0\0\0\0"
    grants.release()
    grants.release()
    device.unlink()
    (target,) = ProcessGrants(RealtimeSettings(lock_memory=False)).request()
    assert not target.ok
    assert "udev" in target.mend


def test_priorities_have_a_range():
    with pytest.raises(ValueError, match="0 \\(off\\) to 99, not 100"):
        RealtimeSettings(priority=100)

"""Requests to the operating system: granted or refused, never silent."""

import os
import resource
import threading

import pytest

from hilserver.scheduler import realtime
from hilserver.scheduler.realtime import (
    ProcessGrants,
    RealtimeSettings,
    request_for_this_thread,
)


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
    assert [(g.name, g.ok) for g in grants] == [
        ("timer_slack", True),
        ("thread_core", True),
    ]


@pytest.mark.skipif(
    len(os.sched_getaffinity(0)) < 2, reason="one core: there is no other"
)
def test_the_core_of_the_pacing_thread_is_left_by_all_others_until_the_end():
    before = os.sched_getaffinity(0)
    cpu = max(before)
    settings = RealtimeSettings(cpu=cpu, lock_memory=False, hold_latency_target=False)
    waiting, done = threading.Event(), threading.Event()
    bystander = threading.Thread(target=lambda: (waiting.set(), done.wait()))
    bystander.start()
    waiting.wait()
    grants = ProcessGrants(settings)
    (core,) = grants.request()
    try:
        assert (core.name, core.ok) == ("core_of_its_own", True)
        for thread in (0, bystander.native_id):
            assert os.sched_getaffinity(thread) == before - {cpu}
        assert in_thread(RealtimeSettings(priority=0, cpu=cpu))[1] == {cpu}
    finally:
        grants.release()
        done.set()
    assert (
        os.sched_getaffinity(0) == os.sched_getaffinity(bystander.native_id) == before
    )


def test_the_only_core_is_named(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3})
    settings = RealtimeSettings(cpu=3, lock_memory=False, hold_latency_target=False)
    (core,) = ProcessGrants(settings).request()
    assert (core.ok, core.remedy) == (False, "use a second core")


def test_a_core_that_is_not_there_is_named():
    grants, _ = in_thread(RealtimeSettings(priority=0, cpu=4000))
    (core,) = (g for g in grants if g.name == "thread_core")
    assert not core.ok
    assert core.wanted == "core 4000"
    assert core.remedy.startswith("choose one of")


def test_a_refused_priority_is_visible(monkeypatch):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    grants, _ = in_thread(RealtimeSettings(priority=70))
    (priority,) = (g for g in grants if g.name == "thread_priority")
    assert (priority.ok, priority.wanted) == (False, "SCHED_FIFO 70")
    assert priority.found == "Operation not permitted"
    assert "LimitRTPRIO=70" in priority.remedy


def test_memory_is_not_locked_under_a_finite_limit_without_the_capability(monkeypatch):
    monkeypatch.setattr(realtime, "has_capability", lambda number: False)
    monkeypatch.setattr(resource, "getrlimit", lambda which: (65536, 65536))
    grants = ProcessGrants(RealtimeSettings(hold_latency_target=False))
    (lock,) = grants.request()
    assert (lock.ok, lock.found) == (False, "limit 64 KiB")
    assert "LimitMEMLOCK" in lock.remedy
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
    assert "udev" in target.remedy


def test_priorities_have_a_range():
    with pytest.raises(ValueError, match="0 \\(off\\) to 99, not 100"):
        RealtimeSettings(priority=100)

"""Alive and ready, judged on plain values."""

import pytest

from hilserver.monitoring.health_http import HealthSources, alive, ready
from hilserver.signals import State

NOW_NS = 100 * 10**9


def sources(
    state: str = "running", heartbeat_ns: int = NOW_NS, first_ticks_met: bool = True
) -> HealthSources:
    return HealthSources(
        state=lambda: state,
        heartbeat_ns=lambda: heartbeat_ns,
        first_ticks_met=lambda: first_ticks_met,
        heartbeat_limit_s=0.5,
    )


@pytest.mark.parametrize("state", [state.word for state in State])
def test_a_beating_heart_is_alive_in_every_state(state: str) -> None:
    assert alive(sources(state), NOW_NS).ok


def test_a_frozen_pacing_back_end_is_dead_and_the_sentence_says_since_when() -> None:
    frozen = sources(heartbeat_ns=NOW_NS - 2_500_000_000)
    assert not alive(frozen, NOW_NS).ok
    assert not ready(frozen, NOW_NS).ok
    assert "2.5 s ago" in alive(frozen, NOW_NS).reason


def test_the_limit_itself_is_still_alive() -> None:
    assert alive(sources(heartbeat_ns=NOW_NS - 500_000_000), NOW_NS).ok
    assert not alive(sources(heartbeat_ns=NOW_NS - 500_000_001), NOW_NS).ok


def test_before_the_first_wake_up_only_starting_is_alive() -> None:
    assert alive(sources("starting", heartbeat_ns=0), NOW_NS).ok
    assert not alive(sources("running", heartbeat_ns=0), NOW_NS).ok


@pytest.mark.parametrize("state", ["starting", "paused", "safe", "stopping"])
def test_ready_is_running_only(state: str) -> None:
    verdict = ready(sources(state), NOW_NS)
    assert not verdict.ok
    assert state in verdict.reason


def test_ready_waits_for_the_first_ticks() -> None:
    assert not ready(sources(first_ticks_met=False), NOW_NS).ok
    assert ready(sources(), NOW_NS).ok

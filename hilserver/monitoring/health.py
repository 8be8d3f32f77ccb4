"""Is the daemon alive, is it ready: two judgements on plain values, without clock or socket.

*Alive* means that the pacing back end woke up a short time ago, also while paused; a frozen one is
dead even when the event loop still answers. *Ready* means that the robot is being simulated: state
``running``, and the first ticks met their deadlines.
"""

from collections.abc import Callable
from dataclasses import dataclass

from hilserver.signals import State


@dataclass(frozen=True, slots=True)
class Verdict:
    """The answer to one question."""

    ok: bool
    reason: str


@dataclass(frozen=True, kw_only=True)
class HealthSources:
    """What the judgements read."""

    state: Callable[[], str]  # state of the daemon in lower case, ``running`` and so on
    # CLOCK_MONOTONIC [ns] of the newest wake-up of the pacing back end; 0 before the first
    heartbeat_ns: Callable[[], int]
    # True once the first ticks after the warm-up met their deadlines
    first_ticks_met: Callable[[], bool]
    heartbeat_limit_s: float = 1.0  # a pacing back end silent for longer than this [s] is dead


def alive(sources: HealthSources, now_ns: int) -> Verdict:
    """Judge the heartbeat of the pacing back end at `now_ns` [CLOCK_MONOTONIC ns]."""
    heartbeat_ns = sources.heartbeat_ns()
    if heartbeat_ns == 0:
        if sources.state() == State.STARTING.word:
            return Verdict(True, "the plant is being compiled and warmed up")
        return Verdict(False, "the pacing back end has never woken up")
    age_s = (now_ns - heartbeat_ns) / 1e9
    if age_s > sources.heartbeat_limit_s:
        return Verdict(False, f"the pacing back end last woke up {age_s:.1f} s ago")
    return Verdict(True, "the pacing back end is running")


def ready(sources: HealthSources, now_ns: int) -> Verdict:
    """Judge whether the robot is being simulated in time at `now_ns` [CLOCK_MONOTONIC ns]."""
    verdict = alive(sources, now_ns)
    if not verdict.ok:
        return verdict
    state = sources.state()
    if state != State.RUNNING.word:
        return Verdict(False, f"the state is {state}, not running")
    if not sources.first_ticks_met():
        return Verdict(False, "the first ticks have not met their deadlines yet")
    return Verdict(True, "running, and the first ticks met their deadlines")

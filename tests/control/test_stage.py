"""The judge of the matrix: a robot that does not stand is never taken for one that does."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

from tests.control import stage as stage_module
from tests.control.robot import COMMANDING, LEASE_MS, History
from tests.control.stage import SLACK_MS, Stage

LIMIT_MS = LEASE_MS["page"] + SLACK_MS
SAFE_RAMP = 2.0
SIGNALS = (
    "control.mode",
    "twist.linear_m_s",
    "wheel.fl.setpoint_rpm",
    "wheel.fl.duty_command_pct",
    "drive.enable",
    "internal.command",
    "sim.state",
)


def judged(monkeypatch, *, until_ms, stops_ms, rpm=20.0, then=0.0, command=COMMANDING):
    """Judge a robot that is silent from 0 ms on, and whose newest frame is of `until_ms`."""
    monkeypatch.setattr(stage_module, "SOON_S", 0.0)
    at_ns = time.monotonic_ns() - 3600 * 10**9
    times_ms = np.arange(0, until_ms)
    has_stopped = times_ms >= stops_ms
    values = np.zeros((len(times_ms), len(SIGNALS)))
    values[:, SIGNALS.index("drive.enable")] = 1.0
    values[:, SIGNALS.index("wheel.fl.setpoint_rpm")] = np.where(has_stopped, then, rpm)
    values[:, SIGNALS.index("internal.command")] = np.where(
        has_stopped, command, COMMANDING
    )
    batch = SimpleNamespace(values=values, planned_ns=at_ns + times_ms * 1_000_000)
    seen = History(batch, {name: i for i, name in enumerate(SIGNALS)})
    stage = Stage.__new__(Stage)
    stage.robot = SimpleNamespace(
        eye=SimpleNamespace(since=lambda _: seen, now=lambda: seen)
    )
    stage._stands("page", 0, at_ns)


def test_a_robot_that_stops_in_time_stands(monkeypatch):
    judged(monkeypatch, until_ms=LIMIT_MS + 300, stops_ms=LIMIT_MS)


def test_in_the_safe_state_it_stands_whatever_is_commanded(monkeypatch):
    judged(
        monkeypatch,
        until_ms=LIMIT_MS + 300,
        stops_ms=LIMIT_MS,
        then=20.0,
        command=SAFE_RAMP,
    )


def test_a_robot_that_goes_on_does_not_stand(monkeypatch):
    with pytest.raises(AssertionError, match="it turns for"):
        judged(monkeypatch, until_ms=LIMIT_MS + 300, stops_ms=LIMIT_MS + 100)


@pytest.mark.parametrize("until_ms", [0, 10, LIMIT_MS])
def test_frames_that_end_early_show_nothing(monkeypatch, until_ms):
    with pytest.raises(AssertionError, match="no tick"):
        judged(monkeypatch, until_ms=until_ms, stops_ms=LIMIT_MS + 100)


def test_a_command_that_is_no_number_is_no_standstill(monkeypatch):
    with pytest.raises(AssertionError, match="it turns for"):
        judged(monkeypatch, until_ms=LIMIT_MS + 300, stops_ms=LIMIT_MS, then=np.nan)

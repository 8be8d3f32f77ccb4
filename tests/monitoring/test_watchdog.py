"""What the service manager hears: over a real datagram socket, and what decides it."""

import asyncio
import os
import socket
from pathlib import Path

import pytest

from hilserver.monitoring.watchdog import Watchdog, notify, watchdog_period_s


@pytest.fixture(params=["path", "abstract"])
def manager(request, tmp_path: Path, monkeypatch):
    """A service manager's socket, in the file system or abstract."""
    name = (
        str(tmp_path / "notify")
        if request.param == "path"
        else f"@hilserver-{os.getpid()}"
    )
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind("\0" + name[1:] if name.startswith("@") else name)
        listener.settimeout(2)
        monkeypatch.setenv("NOTIFY_SOCKET", name)
        yield listener


def test_assignments_arrive_as_one_datagram(manager) -> None:
    assert notify("READY=1", "STATUS=running")
    assert manager.recv(4096) == b"READY=1\nSTATUS=running"


def test_without_a_manager_nothing_is_sent(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    assert not notify("READY=1")
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "nobody"))
    assert not notify("READY=1")


@pytest.mark.parametrize(
    ("usec", "pid", "period_s"),
    [
        ("3000000", "", 3.0),
        pytest.param("3000000", str(os.getpid()), 3.0, id="own"),
        ("3000000", "1", None),
        ("", "", None),
        ("0", "", None),
        ("soon", "", None),
    ],
)
def test_the_period_is_for_this_process_only(monkeypatch, usec, pid, period_s) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", usec)
    monkeypatch.setenv("WATCHDOG_PID", pid)
    assert watchdog_period_s() == period_s


class Robot:
    """A daemon's figures, set by hand, and what was told of them."""

    def __init__(self) -> None:
        self.heartbeat_ns = 0
        self.is_ready = False
        self.status = "starting"
        self.listens = True
        self.heard: list[str] = []
        self.watchdog = Watchdog(
            heartbeat_ns=lambda: self.heartbeat_ns,
            ready=lambda: self.is_ready,
            status=lambda: self.status,
            send=self.send,
        )

    def send(self, *assignments: str) -> bool:
        if self.listens:
            self.heard += assignments
        return self.listens

    def look(self) -> list[str]:
        self.heard.clear()
        self.watchdog.look()
        return list(self.heard)


def test_only_a_beating_plant_feeds_the_watchdog() -> None:
    robot = Robot()
    assert robot.look() == ["STATUS=starting"]
    robot.heartbeat_ns = 1
    assert robot.look() == ["WATCHDOG=1"]
    assert robot.look() == []  # the event loop is alive, the plant is not
    robot.heartbeat_ns = 2
    assert robot.look() == ["WATCHDOG=1"]


def test_ready_is_said_once_and_again_until_it_is_heard() -> None:
    robot = Robot()
    robot.is_ready, robot.listens = True, False
    assert "READY=1" not in robot.look()
    robot.listens = True
    assert "READY=1" in robot.look()
    assert "READY=1" not in robot.look()


def test_a_reload_is_announced_only_by_a_service_that_is_ready() -> None:
    robot = Robot()
    with robot.watchdog.reloading():
        pass
    assert robot.heard == []
    robot.is_ready = True
    robot.look()
    robot.heard.clear()
    with robot.watchdog.reloading():
        assert robot.heard[0] == "RELOADING=1"
        assert robot.heard[1].startswith("MONOTONIC_USEC=")
    assert robot.heard[-1] == "READY=1"


async def test_it_looks_more_often_than_the_period_and_says_goodbye(
    monkeypatch,
) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", "40000")
    monkeypatch.delenv("WATCHDOG_PID", raising=False)
    robot = Robot()
    async with robot.watchdog.watching():
        async with asyncio.timeout(120):
            for beat in range(1, 6):
                robot.heartbeat_ns = beat
                while robot.heard.count("WATCHDOG=1") < beat:  # noqa: ASYNC110
                    await asyncio.sleep(0.001)
    assert robot.heard[-2:] == ["STOPPING=1", "STATUS=stopping"]

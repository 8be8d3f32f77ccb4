"""Hosts in C drive the running daemon over its line."""

import asyncio
import contextlib
import os
import time

import numpy as np
import pytest

from hilserver.errors import FailedError
from hilserver.io.shield import words as w
from hilserver.io.shield.protocol import BYTE_NS, ShieldCommand, request
from tests.io.shield.conftest import random_bytes, running_robot

pytestmark = [pytest.mark.asyncio(loop_scope="module")]

LINE_MS = (11 + 32) * 10 / 115.2 + 1.0
"""Request, reply delay and response on a line of 115200 baud."""


@pytest.mark.parametrize("blocking", [1, 0])
@pytest.mark.parametrize(("rate", "count"), [(10, 10), (50, 50), (100, 100)])
async def test_a_host_drives(robot, rate, count, blocking):
    await robot.forget()
    saw = await robot.host(rate=rate, count=count, blocking=blocking, rpm=30)
    assert saw["answered"] >= count + 1
    assert (saw["wrong_echo"], robot.status.count(w.SKIPPED)) == (0, 0)
    assert saw["shortest_ms"] >= LINE_MS
    assert robot.setpoints() == [30, 30, -30, -30]
    assert robot.status.enabled


async def test_the_plant_follows_and_the_response_shows_it(robot):
    await robot.forget()
    async with robot.started_host(rate=50, count=10_000, rpm=40):
        await robot.until(
            lambda: abs(robot.read("wheel.fl.speed_rpm") - 40) < 0.5, "drives"
        )
        assert robot.read("wheel.fr.speed_rpm") == pytest.approx(-40, abs=1)
        await robot.until(lambda: robot.status.connected, "the host has the line open")
    await robot.until(
        lambda: not robot.status.connected, "the host has closed the line"
    )


async def test_no_response_is_earlier_than_the_line_permits(robot):
    await robot.forget()
    await robot.host(rate=100, count=100)
    due, written = robot.writes().T
    assert (written >= due).all()
    assert (np.diff(written) >= 32 * BYTE_NS).all()


async def test_silence_withdraws_enable_and_a_command_brings_it_back(robot):
    await robot.forget()
    await robot.host(timeout_s=0.3, count=20)
    assert robot.device.limit_ns == pytest.approx(300_000_000, rel=1e-6)
    limit_ns = robot.device.limit_ns
    await robot.until(
        lambda: robot.status.words[w.LIMIT] == limit_ns, "the line's thread has it"
    )
    await robot.until(lambda: robot.read("drive.enable") == 0.0, "enable is withdrawn")
    await robot.until(lambda: robot.status.stale, "the host is silent")
    assert not robot.status.enabled
    await robot.until(lambda: abs(robot.read("wheel.fl.speed_rpm")) < 0.5, "it stops")
    await robot.host(count=5, enable=0)
    assert not robot.status.enabled
    assert robot.status.fault_counts["while_disabled"] >= 5
    async with robot.started_host(timeout_s=600, count=10_000):
        await robot.until(lambda: robot.read("drive.enable") == 1.0, "enable is back")
        await robot.until(
            lambda: abs(robot.read("wheel.fl.speed_rpm") - 30) < 0.5, "it drives"
        )


async def test_a_request_too_many_is_counted_and_the_rest_answered(robot):
    await robot.forget()
    host = os.open(robot.shield.address, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    os.write(host, request(ShieldCommand.SET_RPM) * 2)
    await robot.until(lambda: robot.status.count(w.RESPONSES) == 2, "both are answered")
    os.close(host)


async def test_another_source_keeps_control(robot):
    await robot.forget()
    robot.daemon.gate.take("opcua")
    robot.daemon.gate.write(
        "opcua", {"drive.enable": True, "wheel.fl.setpoint_rpm": 7.0}
    )
    saw = await robot.host(count=10, rpm=30)
    assert saw["answered"] >= 11
    assert robot.daemon.gate.newest("wheel.fl.setpoint_rpm") == 7.0
    assert robot.daemon.gate.rejected["shield", "not_in_control"] > 0
    robot.daemon.gate.take("shield")


async def flooded(robot, data):
    """Write `data` as fast as the line takes it, and read what comes back."""
    host = os.open(robot.shield.address, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        sent = 0
        while sent < len(data):
            try:
                sent += os.write(host, data[sent : sent + 512])
            except BlockingIOError:
                await asyncio.sleep(0.001)
            with contextlib.suppress(BlockingIOError):
                os.read(host, 65536)
        await robot.until(
            lambda: robot.status.count(w.BYTES) >= len(data), "all was read"
        )
        await robot.until(robot.is_idle, "all was answered")
    finally:
        os.close(host)


async def is_in_step(robot):
    """The next host loses nothing."""
    await robot.forget()
    saw = await robot.host(count=20)
    assert (saw["answered"], saw["wrong_echo"]) == (21, 0)
    assert robot.setpoints() == [30, 30, -30, -30]


async def test_a_million_random_bytes_leave_it_alive_and_in_step(
    tmp_path, host_program
):
    async with running_robot(tmp_path, host_program, pace=False) as robot:
        await flooded(robot, random_bytes(1_000_000))
        await is_in_step(robot)


async def test_a_real_line_is_answered_and_its_loss_survived(tmp_path, host_program):
    """The far end of another pseudo-terminal stands for a serial line of the computer."""
    near, far = os.openpty()
    device = os.ttyname(far)
    os.close(far)
    async with running_robot(tmp_path, host_program, device=device) as robot:
        os.write(near, request(ShieldCommand.ENABLE))
        os.set_blocking(near, False)
        got = bytearray()

        def answered():
            with contextlib.suppress(BlockingIOError):
                got.extend(os.read(near, 64))
            return len(got) == 32

        await robot.until(answered, "the line to answer")
        assert got[0] == ShieldCommand.ENABLE
        os.close(near)

        def is_named():
            recent = robot.daemon.events.recent
            return any(device in e.message and "lost" in e.message for e in recent)

        await robot.until(is_named, "the loss is an event")
        await robot.until(lambda: not robot.status.connected, "the line is lost")
    thread = robot.shield._thread
    assert not thread.is_alive(), (
        "it would open the line again and take what the next one is sent"
    )


async def test_what_comes_when_a_line_is_back_belongs_to_nothing_before(
    tmp_path, host_program, monkeypatch
):
    """A request is half there when the line is lost; the next one waits when it is back."""
    device = tmp_path / "line"
    near, far = os.openpty()
    device.symlink_to(os.ttyname(far))
    limits = {"device": str(device), "stale_after_ms": 100}
    async with running_robot(tmp_path, host_program, **limits) as robot:
        os.close(far)
        words, opened, back_ns = robot.status.words, robot.shield._opened, []
        os.write(
            near, request(ShieldCommand.ENABLE) + request(ShieldCommand.ENABLE)[:5]
        )
        await robot.until(
            lambda: words[w.RING_TAIL] == 1 and words[w.FILL] == 5,
            "a request and a half are there",
        )

        def opened_and_sent():
            line = opened()
            back_ns.append(time.monotonic_ns())
            os.write(near, request(ShieldCommand.ENABLE))
            return line

        monkeypatch.setattr(robot.shield, "_opened", opened_and_sent)
        device.unlink()
        os.close(near)
        await robot.until(lambda: robot.shield.address == "", "the line is lost")
        near, far = os.openpty()
        device.symlink_to(os.ttyname(far))
        await robot.until(
            lambda: back_ns and words[w.RING_TAIL] == 2, "the request is taken"
        )
        assert robot.shield._received_ns >= back_ns[0]
        assert words[w.SKIPPED] == 0
    os.close(near)
    os.close(far)


async def test_a_mistyped_device_ends_the_start_with_a_sentence(tmp_path, host_program):
    with pytest.raises(FailedError, match=r"there is no .*ttyS77"):
        async with running_robot(
            tmp_path, host_program, device=str(tmp_path / "ttyS77")
        ):
            pass
    assert not (tmp_path / "ttyS77").exists()


@pytest.mark.long
async def test_a_million_random_bytes_at_the_speed_of_the_line(tmp_path, host_program):
    async with running_robot(tmp_path, host_program) as robot:
        await flooded(robot, random_bytes(1_000_000))
        await is_in_step(robot)

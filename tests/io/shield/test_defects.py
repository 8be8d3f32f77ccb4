"""Defects 6 to 13 of the real drivers: the symptom with a host that has it, none with a right one.

The numbers and where each shows: docs/reference/shield.md.
"""

import asyncio

import pytest

from hilserver.io.shield import words as w

pytestmark = [pytest.mark.asyncio(loop_scope="module")]


@pytest.fixture(autouse=True)
async def _fresh(robot):
    await robot.forget()


def faults(robot):
    return dict(+robot.status.fault_counts)


async def test_6_time_out_a_thousand_times_too_long(robot):
    await robot.host(timeout_s=0.5, count=3, defect=6)
    assert robot.device.limit_ns == 500_000 * 10**9
    await asyncio.sleep(1.5)  # three times what the host wanted
    assert robot.status.enabled
    await robot.forget()
    await robot.host(timeout_s=0.5, count=3)
    assert robot.device.limit_ns == 500_000_000
    await robot.until(lambda: not robot.status.enabled, "enable is withdrawn")


async def test_7_frequency_as_a_float(robot):
    await robot.host(frequency=8000, count=1, defect=7)
    assert faults(robot)["frequency_form"] == 1
    assert robot.status.parameters["frequency"] > 1e9
    await robot.forget()
    await robot.host(frequency=8000, count=1)
    assert robot.status.parameters["frequency"] == 8000
    assert not faults(robot)


async def test_8_flag_in_the_wrong_byte(robot):
    saw = await robot.host(raw=1, count=1, defect=8)
    assert not robot.status.raw_imu
    assert saw["field_17"] > 1000  # the host takes a temperature for a turn rate
    await robot.forget()
    saw = await robot.host(raw=1, count=1)
    assert robot.status.raw_imu
    assert saw["field_17"] == 0


async def test_9_no_resynchronisation(robot):
    saw = await robot.host(lose_response=5, count=20, defect=9)
    assert saw["wrong_echo"] >= 15
    await robot.forget()
    saw = await robot.host(lose_response=5, count=20)
    assert saw["wrong_echo"] == 1


async def test_10_end_byte_unset_until_the_first_enable(robot):
    saw = await robot.host(configure=8, count=3, defect=10)
    assert faults(robot)["unterminated"] == robot.status.count(w.UNTERMINATED) == 8
    assert saw["wrong_echo"] == 0  # answered all the same, as the driver needs it
    await robot.forget()
    await robot.host(configure=8, count=3)
    assert not faults(robot)


async def test_11_reads_once_and_waits_for_ever(robot):
    async with robot.started_host(lose_request=3, count=20, defect=11) as host:
        lost = 2 * 11 + 10
        await robot.until(
            lambda: robot.status.count(w.BYTES) >= lost, "a request is cut short"
        )
        await asyncio.sleep(1.0)
        assert host.returncode is None
        assert robot.status.count(w.BYTES) == lost
    await robot.forget()
    saw = await robot.host(lose_request=3, count=20, wait_ms=1000)
    assert saw["late"] >= 1
    assert (saw["answered"], saw["wrong_echo"]) == (21, 0)


async def test_12_a_stray_stop_character_on_opening(robot):
    await robot.host(count=3, defect=12)
    assert robot.status.count(w.SKIPPED) == 1
    assert robot.status.count(w.RESPONSES) >= 4
    await robot.forget()
    await robot.host(count=3)
    assert robot.status.count(w.SKIPPED) == 0


async def test_13_rounding_towards_zero(robot):
    await robot.host(rpm=10, count=3, defect=13)
    assert robot.setpoints() == [10.0, 10.0, -9.99, -9.99]
    await robot.host(rpm=10, count=3)
    assert robot.setpoints() == [10.0, 10.0, -10.0, -10.0]

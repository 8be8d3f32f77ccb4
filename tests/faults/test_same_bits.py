"""The same faults at the same ticks give the same bits: back ends, snapshots, processes."""

import asyncio
import hashlib
import subprocess
import sys
from pathlib import Path

import pytest

from hilserver.image import Row
from tests.faults.rig import Rig

FAULTS = (
    {
        "fault": "noise",
        "signal": "imu.gyro_z_rad_s",
        "sd": 0.1,
        "seed": 1,
        "from_s": 0.1,
    },
    {"fault": "jitter", "signal": "wheel.fl.setpoint_rpm", "jitter_s": 0.2, "seed": 2},
    {
        "fault": "drop",
        "signal": "pose.x_m",
        "probability": 0.4,
        "seed": 3,
        "every_s": 0.02,
    },
    {
        "fault": "reorder",
        "signal": "tof.fl_m",
        "probability": 0.2,
        "delay_s": 0.1,
        "seed": 4,
    },
    {
        "fault": "force",
        "signal": "wheel.rr.setpoint_rpm",
        "value": -20,
        "from_s": 1,
        "for_s": 0.5,
    },
    {
        "fault": "spike",
        "signal": "battery.voltage_v",
        "size": 3,
        "probability": 0.01,
        "seed": 5,
    },
    {"fault": "hold", "signal": "wheels.speeds_rpm", "every_s": 0.05, "until_s": 2.5},
)
N = 3000


def prepare(rig, first_tick=0):
    slots = rig.table["wheels.setpoints_rpm"].slots
    rows = [
        Row(slots[i % 4], float((i * 37) % 90 - 45), tick=i * 7)
        for i in range(N // 7)
        if i * 7 >= first_tick
    ]
    assert rig.image.push_timed(rows)


def digest(rig, first_tick=0):
    frames = rig.frames(first_tick)
    assert len(frames) == N - first_tick
    text = b"".join(frame.values.tobytes() + frame.status.tobytes() for frame in frames)
    return hashlib.sha256(text).hexdigest()


async def drive(backend, faults=FAULTS):
    async with Rig(backend) as rig:
        prepare(rig)
        rig.faults.inject(*faults, start_tick=0)
        async with asyncio.timeout(120):
            await rig.advance(N)
        return digest(rig)


async def test_three_back_ends_give_the_same_bits_and_another_seed_gives_others():
    virtual = await drive("virtual")
    assert await drive("timerfd") == virtual
    assert await drive("thread") == virtual
    other = (FAULTS[0] | {"seed": 99}, *FAULTS[1:])
    assert await drive("virtual", other) != virtual


async def continue_from(folder, first_tick):
    """Run on from the snapshot; called in a process of its own."""
    async with Rig(folder=folder) as rig:
        assert await rig.snapshots.load("middle") == first_tick
        prepare(rig, first_tick)
        await rig.advance(N - first_tick)
        return digest(rig, first_tick)


@pytest.mark.parametrize("first_tick", [1_234])
async def test_a_snapshot_carries_active_and_waiting_faults(tmp_path, first_tick):
    async with Rig(folder=tmp_path) as rig:
        prepare(rig)
        rig.faults.inject(*FAULTS, start_tick=0)
        await rig.advance(first_tick)
        await rig.snapshots.save("middle")
        await rig.advance(N - first_tick)
        expected = digest(rig, first_tick)
    code = (
        "import asyncio; from tests.faults.test_same_bits import continue_from;"
        f"print(asyncio.run(continue_from({str(tmp_path)!r}, {first_tick})))"
    )
    run = await asyncio.to_thread(
        subprocess.run,
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=600,
        cwd=Path(__file__).parent.parent.parent,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout.strip() == expected


async def test_without_faults_the_bits_are_those_of_a_run_that_had_one_before_the_reset():
    async with Rig() as clean:
        await clean.advance(50)
        expected = [frame.values.tobytes() for frame in clean.frames()]
    async with Rig() as rig:
        rig.faults.inject(*FAULTS)
        rig.faults.force("drive.enable", 0)
        await rig.advance(100)
        rig.snapshots.reset()
        rig.faults.reset()
        assert rig.faults.active() == []
        await rig.advance(50)
        assert [frame.values.tobytes() for frame in rig.frames()[100:]] == expected

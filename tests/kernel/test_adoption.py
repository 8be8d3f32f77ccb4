"""A state whose numbers are no indices is refused: the compiled step would follow them anywhere."""

import numpy as np
import pytest

from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.builder import build
from hilserver.errors import ControlRefused
from hilserver.kernel.modifier_layout import ModifierEntry, Modifiers
from hilserver.plant.layout import State


def place(name):
    return Modifiers.where(name).start


def entry(name):
    return place("entries") + ModifierEntry.where(name).start


WRONG = [
    ("modifiers", place("count"), 2**40),
    ("modifiers", place("count"), -1),
    ("modifiers", place("touched"), 65),
    ("modifiers", place("slots"), 10**9),
    ("modifiers", entry("slot"), -5),
    ("modifiers", entry("other"), 10**12),
    ("modifiers", entry("ring"), 8),
    ("modifiers", entry("ticks"), 2**50),
    ("modifiers", entry("every"), 0),
    ("modifiers", entry("kind"), 99),
    ("x", State.where("imu_head").start, np.float64(1e300).view(np.int64)),
    ("x", State.where("setpoint_head").start, np.float64("nan").view(np.int64)),
    ("x", State.where("nav_count").start, np.float64(-1.0).view(np.int64)),
]


async def test_a_damaged_state_is_refused_and_a_sound_one_with_faults_is_not(tmp_path):
    async with build(assemble_config(Config(), tmp_path)) as core:
        core.faults.inject(
            {"fault": "delay", "signal": "imu.gyro_z_rad_s", "delay_s": 0.02}
        )
        core.faults.inject(
            {"fault": "bias", "signal": "battery.voltage_v", "offset": 1.0}
        )
        await core.scheduler.advance(50)
        path = await core.snapshots.save("sound")
        await core.snapshots.load("sound")
        await core.scheduler.advance(50)
        with np.load(path) as archive:
            state = archive["state"]
        for region, place, value in WRONG:
            damaged = state.copy()
            first = (
                core.image.layout.regions[region].base
                - core.image.layout.regions["live"].base
            )
            assert damaged[first + place] != value
            damaged[first + place] = value
            with pytest.raises(ControlRefused, match="the state is damaged"):
                await core.snapshots.restore(damaged, 50)
        await core.scheduler.advance(50)


async def test_a_flipped_bit_differs_from_the_checksum(tmp_path):
    async with build(assemble_config(Config(), tmp_path)) as core:
        path = await core.snapshots.save("a")
        with np.load(path) as archive:
            state, meta = archive["state"], archive["meta"]
        state[100] ^= 1
        np.savez(path, state=state, meta=meta)
        with pytest.raises(ControlRefused, match="checksum differs"):
            await core.snapshots.load("a")

"""What can be switched on while the daemon runs needs no compiler."""

import asyncio

import pytest

from hilserver.compiled.stored import Stored
from tests.faults.rig import Rig
from tests.faults.test_same_bits import FAULTS

SLIMMEST = {"shield": {"enabled": False}, "sensors": {"nav": {"enabled": False}}}
TERMS = {
    "terms.dead_zone": 3.0,
    "terms.stribeck_friction": 2.0,
    "terms.backlash": 1.0,
    "kinematics.rotation_gain": 1.05,
    "terms.actuation_delay": 0.02,
}


@pytest.fixture
def asked_for(monkeypatch):
    """What is looked for in the cache of compiled code: all that is compiled passes there first."""
    names = []
    load = Stored.load_overload

    def load_and_note(self, *what):
        names.append(self._readable)
        return load(self, *what)

    monkeypatch.setattr(Stored, "load_overload", load_and_note)
    return names


async def test_faults_forces_and_terms_compile_nothing(asked_for):
    async with Rig(config=SLIMMEST) as rig:
        await rig.advance(5)
        assert asked_for, "the listener does not see what a start takes from the cache"
        asked_for.clear()

        rig.faults.inject(*FAULTS, start_tick=10)
        rig.faults.force("battery.voltage_v", 9.5)
        assert rig.core.parameters.write("test", TERMS) == {}
        rig.write(wheels__setpoints_rpm=30.0)
        async with asyncio.timeout(60):
            await rig.advance(200)
        assert asked_for == []

"""The FMU of `model.c` in both versions, and a robot that has it in its plant's slice."""

from contextlib import asynccontextmanager

import numpy as np
import pytest

from hilserver.daemon.builder import build
from hilserver.image import Row
from tests.fmu.rig import configured, description, make

BLOCK = {"name": "motor", "inputs": {"u": "wheel.fl.setpoint_rpm"}}
"""One wiring for all tests: its step is compiled once."""
FIXED = 'name="lag" valueReference="4" causality="parameter" variability="fixed"'


@pytest.fixture(scope="session")
def fmus(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fmus")
    for version in (2, 3):
        make(folder / f"lag{version}.fmu", version)
        make(folder / f"stateless{version}.fmu", version, "-DSTATELESS", state=False)
        both = description(version).replace(FIXED, FIXED.replace("fixed", "tunable"))
        make(folder / f"together{version}.fmu", version, "-DTOGETHER", text=both)
    return folder


class Robot:
    """Plant and FMU in virtual time."""

    def __init__(self, core):
        self.core, self.table, self.image = core, core.table, core.image

    async def run(self, n, fl=None):
        if fl is not None:
            self.image.push([Row(self.table.slot("wheel.fl.setpoint_rpm"), fl)])
        await self.core.scheduler.advance(n)

    def output(self, name, n=None):
        """The newest value, or the newest `n`, of an output of the FMU."""
        slot = self.table.slot(f"motor.{name}")
        head = self.image.head
        values = np.array(
            [self.image.frame(i).values[slot] for i in range(head - (n or 1), head)]
        )
        return values if n else values[0]

    def status(self, name):
        return int(self.image.latest().status[self.table.slot(f"motor.{name}")])

    @property
    def fault(self):
        return self.image.control.first_fault


@pytest.fixture
def robot(fmus, tmp_path):
    """Make a robot with an FMU: ``async with robot(3, process=True) as r``."""

    @asynccontextmanager
    async def make_robot(name, **more):
        block = BLOCK | {"fmu": str(fmus / f"{name}.fmu")} | more
        async with build(configured(tmp_path, block)) as core:
            yield Robot(core)

    return make_robot

"""A recording in which an FMU's answers came late is replayed to the bit."""

import numpy as np
import pytest

import hilserver.fmu.layout as at
from hilserver.daemon.builder import build
from hilserver.image import Row
from hilserver.io.recorder import Recorder, Settings
from tests.fmu.conftest import BLOCK
from tests.fmu.rig import configured
from tests.replay.test_parameters import replayed

SLEEPS = 1
TURNS = 30


@pytest.mark.parametrize("given_up", [False, True])
async def test_slices_that_were_late_are_late_again(fmus, tmp_path, given_up):
    start = {"mischief": SLEEPS, "atStep": 1}
    block = BLOCK | {"fmu": str(fmus / "lag3.fmu"), "process": True, "start": start}
    path = tmp_path / "run.mcap"
    assembly = configured(tmp_path, block, scheduler={"backend": "virtual"})
    async with build(assembly) as core:
        recorder = Recorder(core.image.name, Settings(path, waits=True))
        a, setpoint = (
            core.image.region("motor.a")[1],
            core.table.slot("wheel.fl.setpoint_rpm"),
        )
        for turn in range(TURNS):
            core.image.push([Row(setpoint, 2.0 * turn)])
            if given_up and turn > TURNS // 2:
                a[at.A_LIMIT] = 2
            # these slices are over in a moment, and it sleeps for 5 ms in each
            a[at.A_WAITS] = 0
            await core.scheduler.advance(3)
            a[at.A_WAITS] = 1
            await core.scheduler.advance(4)
            recorder.look()
        recorder.close()
    log, compared, _ = await replayed(path)
    late = log.columns["motor.process_late"]
    assert compared.difference is None
    assert np.ptp(np.abs(late)) > 1
    assert (late.min() < 0) == given_up

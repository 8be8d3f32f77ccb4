"""No tick allocates: numba's own count says so, with all switched on that a robot may have."""

from contextlib import contextmanager
from importlib.util import find_spec

import numba
import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys

from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.builder import build
from hilserver.scheduler.pacing_loop import run_batch

CALLS = 50
NEEDS_MUJOCO = pytest.mark.skipif(
    find_spec("mujoco") is None, reason="needs the extra physics"
)
ROBOTS = {
    "default": {},
    "all terms": {
        "plant": {
            "terms": {"actuation_delay": 0.03, "dead_zone": 4.0, "rotation_gain": -0.1}
        },
        "sensors": {"nav": {"enabled": True}},
        "observer": {"enabled": True},
    },
    "mechatronic": {
        "mechatronic": {"enabled": True, "driven_by": "torque", "sensors": "body"}
    },
}


@contextmanager
def counting():
    _nrt_python.memsys_enable_stats()
    try:
        yield lambda: sum(rtsys.get_allocation_stats()[::2])
    finally:
        _nrt_python.memsys_disable_stats()


def test_the_count_sees_an_allocation():
    @numba.njit
    def allocates(n):
        total = 0.0
        for _ in range(n):
            total += np.ones(3).sum()
        return total

    allocates(1)
    with counting() as allocated:
        before = allocated()
        allocates(10)
        assert allocated() - before >= 10


@pytest.mark.parametrize(
    "robot",
    [pytest.param(r, marks=NEEDS_MUJOCO if r == "mechatronic" else ()) for r in ROBOTS],
)
async def test_no_tick_allocates(robot, tmp_path):
    """What a call from Python takes is counted with few ticks; with many it may not be more."""
    settings = {"scheduler": {"backend": "virtual"}} | ROBOTS[robot]
    async with build(
        assemble_config(Config.model_validate(settings), tmp_path)
    ) as core:
        core.image.control.state = 1
        core.faults.inject(
            {"fault": "bias", "signal": "imu.gyro_z_rad_s", "offset": 0.2},
            {"fault": "delay", "signal": "wheel.fl.speed_rpm", "delay_s": 0.02},
        )
        core.gate.write("opcua", {"control.mode": 1, "twist.linear_m_s": 0.2})
        await core.scheduler.advance(1000)
        machine, counts = core.scheduler._machine, []
        with counting() as allocated:
            for n_ticks in (1, 500):
                core.scheduler.resume()
                before, first = allocated(), core.scheduler.tick
                for _ in range(CALLS):
                    run_batch(machine.step, machine.loop, n_ticks)
                counts.append(allocated() - before)
            core.scheduler.pause()
            assert core.scheduler.tick - first > 10 * CALLS
        assert counts[0] == counts[1]

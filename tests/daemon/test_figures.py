"""The gap between robot and model, from the frame that holds both."""

import math

from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.builder import build
from hilserver.daemon.daemon import Daemon
from hilserver.daemon.figures import model_gap, slice_table
from tests.io.opcua_client.conftest import wait_until


async def test_before_its_first_run_a_slice_has_no_worst_tick() -> None:
    config = Config.model_validate({"scheduler": {"backend": "virtual"}})
    async with build(assemble_config(config)) as core:
        plant = slice_table(core.scheduler)["plant"]
        ticks = [value for name, value in plant.items() if name.endswith("_tick")]
        assert ticks == [None] * 3
        assert plant["margin_min_us"] is None
        await core.scheduler.advance(1)
        assert slice_table(core.scheduler)["plant"]["margin_min_tick"] == 0


async def test_model_gap_is_measured_minus_simulated_of_what_is_measured() -> None:
    config = Config.model_validate(
        {
            "image": {"name": "auto"},
            "opcua": {"enabled": False},
            "metrics": {"enabled": False},
            "scheduler": {"backend": "virtual"},
        }
    )
    async with Daemon(assemble_config(config)) as daemon:

        def gaps() -> dict[str, float]:
            return dict(model_gap(daemon.gate, daemon.table, daemon.image.latest()))

        assert gaps() == {}
        await wait_until(
            lambda: slice_table(daemon.scheduler)["plant"]["realtime_factor_total"]
        )
        plant = slice_table(daemon.scheduler)["plant"]
        assert 0 <= plant["margin_min_tick"] < daemon.scheduler.tick
        daemon.control.set_pose(0.0, 0.0, 3.0)
        measured = {"measured.wheel.fl.speed_rpm": 12.5, "measured.pose.yaw_rad": -3.0}
        assert daemon.gate.write("page", measured) == {}
        await wait_until(lambda: len(gaps()) == 2 and gaps()["pose.yaw_rad"] > 0)
        found = gaps()
        assert found["wheel.fl.speed_rpm"] == 12.5
        assert math.isclose(found["pose.yaw_rad"], math.tau - 6.0)
        daemon.gate.mark_stale("page")
        await wait_until(lambda: gaps() == {})

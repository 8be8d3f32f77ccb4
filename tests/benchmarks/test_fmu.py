"""What `bench fmu` drives with: an FMU beside the paced plant, and what came of it."""

import pytest

from benchmarks.fmu_models import Model, beside
from hilserver.errors import ConfigError
from tests.fmu.rig import make
from tests.fmu.test_refusals import CLOCK, description


async def test_a_drive_beside_an_fmu_comes_again_to_the_bit(tmp_path):
    model = Model(make(tmp_path / "lag.fmu", 3))
    drive = await beside(model, tmp_path, 0.1, 0, replay=True)
    assert drive.replayed == "equal"
    assert drive.ticks > 0


async def test_one_with_clocks_is_refused_by_a_sentence(tmp_path):
    path = make(tmp_path / "clocks.fmu", 3, text=description(3, variables=CLOCK))
    with pytest.raises(ConfigError, match="has clocks"):
        await beside(Model(path), tmp_path, 0.1, 0)

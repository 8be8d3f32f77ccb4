"""A sensor's limits with the ends that were reached."""

import numpy as np
import pytest

from hilserver.diagnosis.checks import check
from tests.diagnosis.checks.samples import ROBOT, drive, log_of

GYRO = "imu.gyro_z_rad_s"


@pytest.fixture(scope="module")
def table():
    return drive(3, length_s=60.0)


@pytest.mark.parametrize("ends", [{"low": -0.4, "high": 0.4}, {"high": 0.4}], ids=len)
def test_a_limited_gyro_is_reported_with_the_ends_that_it_reached(table, ends):
    t, columns = table
    readings = np.clip(columns[GYRO], -0.4, 0.4)
    there = readings > ends.get("low", -0.399) - 1e-6
    limited = {**columns, GYRO: np.where(there, readings, np.nan)}
    (finding,) = [
        f
        for f in check(log_of(t, limited), ROBOT).findings
        if f.causes == ("limited_channel",)
    ]
    wanted = {f"limited_channel.{end}": value for end, value in ends.items()}
    found = {name: p.value for name, p in finding.parameters.items()}
    assert found == {"limited_channel": 0.4, **wanted}

"""Measured data as the observer takes it: which wheels of which segment."""

import numpy as np
import pytest

from hilserver.errors import LogError
from hilserver.measured.channels import SPEEDS
from hilserver.measured.observed import series_of
from hilserver.measured.reading import read_measured
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.units import RPM_PER_RAD_S


def two_segments(path, missing):
    """Write 2.4 s twice; the second time some wheels have no sample."""
    lines = [",".join(("t_s", "segment", *SPEEDS))]
    for i in range(240):
        second = i >= 120
        wheels = ["" if second and name in missing else "60" for name in SPEEDS]
        lines.append(f"{0.02 * i:.2f},{int(second)}," + ",".join(wheels))
    path.write_text("\n".join(lines) + "\n")
    return read_measured([path])


@pytest.mark.parametrize("wheel", SPEEDS)
def test_a_wheel_without_samples_in_one_segment_counts_in_the_others(tmp_path, wheel):
    log = two_segments(tmp_path / "run.csv", {wheel})
    first, second = (series_of(log, span, RobotParameters()) for span in (0, 1))
    assert len(first.wheels) == len(second.wheels) == 120
    rad_s = 60.0 / RPM_PER_RAD_S
    np.testing.assert_allclose(second.wheels[:, 1:3], rad_s)


def test_a_segment_without_a_side_is_named(tmp_path):
    log = two_segments(tmp_path / "run.csv", set(SPEEDS[:2]))
    robot = RobotParameters()
    assert len(series_of(log, 0, robot).wheels) == 120
    with pytest.raises(
        LogError, match=r"segment 1 .*wheel\.fl.* leave the segment out"
    ):
        series_of(log, 1, robot)

"""What was probably meant by a name that does not exist."""

import pytest

from hilserver.errors import meant, nearest

SIGNALS = ["segment", "wheel.fl.setpoint_rpm", "wheel.fl.speed_rpm", "imu.gyro_z_rad_s"]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("wheel.fl.setpoint_rmp", "wheel.fl.setpoint_rpm"),
        ("speed", "wheel.fl.speed_rpm"),
        ("Gyro", "imu.gyro_z_rad_s"),
        ("segmnt", "segment"),
        ("x", None),
        ("", None),
    ],
)
def test_the_name_spelt_alike_or_the_first_that_holds_it(name, expected):
    assert nearest(name, SIGNALS) == expected


def test_where_nothing_is_near_the_way_on_is_told():
    assert meant("prot", ["host", "endpoint"], "known are host, endpoint") == (
        "known are host, endpoint"
    )
    assert meant("prt", ["host", "port"], "nothing") == "did you mean 'port'?"

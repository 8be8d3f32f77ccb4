"""How late one source is behind another: one answer for `identify` and the data checks."""

import numpy as np
import pytest

from hilserver.diagnosis.checks import check
from hilserver.identify.rotation import identify_rotation
from hilserver.measured.channels import GYRO, SPEEDS
from tests.diagnosis.checks.samples import ROBOT, drive, log_of
from tests.diagnosis.checks.test_wild_samples import with_wild

EVERY = 5  # rows of the drive, of 20 ms, from one message of the wheels to the next


def odometry(late_s, *, wild=False):
    """Wheel speeds at 10 Hz whose stamps are late, beside a gyro at 50 Hz."""
    t, columns = drive(length_s=260.0, k_om=1.7)
    rows = round(late_s / 0.02)
    kept = {GYRO: with_wild(columns[GYRO], 9.0) if wild else columns[GYRO]}
    for name in SPEEDS:
        speed = np.full(len(t), np.nan)
        speed[rows::EVERY] = columns[name][: len(t) - rows : EVERY]
        kept[name] = speed
    return log_of(t, kept)


@pytest.mark.parametrize("wild", [False, True], ids=["", "wild gyro"])
def test_identify_and_the_data_checks_agree_on_late_odometry(wild):
    log = odometry(0.36, wild=wild)
    (fault,) = check(log, ROBOT).findings
    assert fault.causes == ("clock_offset",)
    assert fault.parameters["clock_offset"].value == pytest.approx(-0.36, abs=0.03)
    own = identify_rotation(log, ROBOT)
    assert own.lag_s.value == pytest.approx(-0.36, abs=0.03)
    assert own.without_lag.value == pytest.approx(1.7 * ROBOT.k_om, rel=0.03)


def test_slow_wheel_samples_alone_are_not_late():
    assert check(odometry(0.0), ROBOT).findings == ()


def test_what_slow_samples_hide_is_no_clock():
    """Two samples of the wheels are 0.2 s."""
    assert check(odometry(0.14), ROBOT).findings == ()

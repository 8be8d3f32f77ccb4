"""Wheels from one topic: what it holds is decided by how the robot followed them."""

import numpy as np
import pytest

from hilserver.diagnosis.decide import one_topic
from hilserver.diagnosis.replay.drive_stage import DriveStage
from hilserver.measured.channels import GYRO, SETPOINTS, SPEEDS
from tests.diagnosis.checks.samples import RAD_S, ROBOT, log_of

LENGTH_S, ROW_S = 60.0, 0.02
COPIED = ("setpoint_as_measurement",)


def recorded(as_sent, *, gain=1.0, changes=True):
    """The log of a robot that turns `gain` times as far as its configured drive makes it."""
    rng, t = np.random.default_rng(3), np.arange(0.0, LENGTH_S, ROW_S)
    sides = np.repeat(rng.uniform(-50.0, 50.0, (2, 25)), 120, axis=1)
    sides = sides if changes else np.broadcast_to([[20.0], [30.0]], sides.shape)
    sent = {n: sides[i // 2] for i, n in enumerate(SETPOINTS)}
    drive = DriveStage(log_of(t, sent), ROBOT, block_s=1.0)
    ticks_s, speed = drive.segments.times(0), drive.simulate({})[0]
    turned = [np.interp(t, ticks_s, speed[:, wheel]) for wheel in range(4)]
    turn = RAD_S * ROBOT.wheel_radius_m * ROBOT.k_om * (turned[0] + turned[2])
    shown = sent.values() if as_sent else turned
    both = {
        **dict(zip(SETPOINTS, shown, strict=True)),
        **dict(zip(SPEEDS, shown, strict=True)),
    }
    noise = 0.006 * rng.standard_normal(len(t))
    return log_of(t, {**both, GYRO: gain * ROBOT.yaw_sign * turn + noise})


@pytest.mark.parametrize("gain", [1.0, 0.54], ids=["as configured", "46 % less"])
def test_set_points_are_judged_behind_the_drive(gain):
    found = one_topic.checked(recorded(as_sent=True, gain=gain), ROBOT)
    assert "judged as set-points" in " ".join(found.log.notices)
    assert [f.causes for f in found.findings] == [COPIED]
    assert found.log.has(*SETPOINTS)
    assert SPEEDS[0] not in found.log


@pytest.mark.parametrize("gain", [1.0, 0.54], ids=["as configured", "46 % less"])
def test_actual_speeds_are_no_fault(gain):
    found = one_topic.checked(recorded(as_sent=False, gain=gain), ROBOT)
    assert "judged as actual speeds" in " ".join(found.log.notices)
    assert COPIED not in [f.causes for f in found.findings]
    assert found.log.has(*SPEEDS)
    assert SETPOINTS[0] not in found.log


def test_where_the_motion_does_not_show_it_both_are_said():
    found = one_topic.checked(recorded(as_sent=True, gain=0.54, changes=False), ROBOT)
    (said,) = [n for n in found.log.notices if "does not show which they are" in n]
    assert "0.54 times as far as configured if they are set-points" in said
    assert "0.54 times if they are speeds" in said
    assert SPEEDS[0] not in found.log


def test_speeds_of_their_own_are_not_asked_about():
    log = recorded(as_sent=True)
    other = log[SPEEDS[0]].with_values(log[SPEEDS[0]].values + 1.0)
    found = one_topic.checked(log.with_channels({SPEEDS[0]: other}), ROBOT)
    assert not any("from one topic" in n for n in found.log.notices)

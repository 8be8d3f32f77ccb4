"""Replays from set-points, measured duty and measured wheel speed tell in which block a fault is.

The faults are the injector's, at their reference sizes.
"""

from dataclasses import replace

import numpy as np
import pytest
from hilserver_injector import nothing

from hilserver.diagnosis.decide.structure import remaining
from hilserver.diagnosis.decide.unknown import families_of
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.replay.model import Model
from hilserver.diagnosis.report.course import courses
from hilserver.diagnosis.report.cuts import cuts, remarks
from hilserver.diagnosis.report.dependence import dependences
from hilserver.diagnosis.report.words import where
from tests.diagnosis.hidden.logs import assembly, prepared

BENCH, DRIVE = ("bench", 500.0, 15.0), ("drive", 50.0, 90.0)


def stages_of(kind, rate_hz, duration_s, *causes, channels=None, **how):
    made = nothing(kind, 3)
    recorder = replace(made.taken, rate_hz=rate_hz)
    if channels is not None:
        recorder = replace(recorder, channels=channels)
    made = replace(
        made, duration_s=duration_s, recorder=recorder, causes=dict(causes), **how
    )
    return prepared(made, assembly().robot)


def ratios(rows, cut, *parts):
    """Residual by expected noise of the channels of one cut whose name holds one of the parts."""
    found = [
        r.rms / r.expected
        for r in rows
        if r.cut == cut and any(p in r.channel for p in parts)
    ]
    assert found, (cut, parts)
    return np.array(found)


@pytest.mark.parametrize(
    ("cause", "size"), [("process_gain", 0.05), ("time_constant", 0.2)]
)
def test_a_fault_of_the_process_shows_from_the_measured_duty(cause, size):
    rows = cuts(stages_of(*BENCH, (cause, size)).values())
    assert ratios(rows, "duty", "speed").min() > 5.0
    assert ratios(rows, "setpoints", "duty").min() > 5.0
    assert where(rows) == "The error arises in the motors, the gears or their load."


def test_a_fault_of_the_process_is_none_of_the_kinematics():
    rows = cuts(stages_of(*DRIVE, ("process_gain", 0.05)).values())
    assert ratios(rows, "duty", "speed").min() > 5.0
    assert ratios(rows, "speed", "nav", "gyro") == pytest.approx(1.0, abs=0.2)


def test_a_fault_of_the_kinematics_shows_from_the_measured_speed_alone():
    rows = cuts(stages_of(*DRIVE, ("rotation_gain", 0.05)).values())
    for cut in ("setpoints", "speed"):
        assert ratios(rows, cut, "yaw", "gyro").min() > 3.0
    assert ratios(rows, "duty", "speed") == pytest.approx(1.0, abs=0.06)
    assert ratios(rows, "setpoints", "wheel") == pytest.approx(1.0, abs=0.06)
    assert where(rows) == "The error arises in the kinematics or in the pose sensors."


@pytest.mark.parametrize(
    "log",
    [
        (*BENCH, ("controller_gains.p", -0.3)),
        (*DRIVE, ("controller_gains.p", -0.3)),
        ("drive", 20.0, 90.0, ("controller_gains.p", -0.3)),
        (*DRIVE, ("saturation_limit", 55.0)),
        (*DRIVE, ("actuation_delay", 0.04)),
    ],
    ids=str,
)
def test_a_fault_before_the_motors_shows_from_the_setpoints_alone(log):
    """Even where the duty between its samples is not known."""
    stages = stages_of(*log)
    rows = cuts(stages.values())
    assert ratios(rows, "setpoints", "duty").min() > 5.0
    assert ratios(rows, "duty", "speed") == pytest.approx(1.0, abs=0.12)
    assert "in the controller" in where(rows)
    assert bool(remarks(stages.values())) == (log[1] < 500.0)


def test_without_a_duty_or_a_speed_there_is_no_such_cut():
    channels = ("setpoint", "speed", "gyro", "nav")
    stages = stages_of("drive", 50.0, 40.0, channels=channels)
    assert {r.cut for r in cuts(stages.values())} == {"setpoints", "speed"}
    stages = stages_of("drive", 50.0, 40.0, channels=("setpoint", "duty", "gyro"))
    rows = cuts(stages.values())
    assert {r.cut for r in rows} == {"setpoints"}
    assert {r.channel for r in rows} >= {"imu.gyro_z_rad_s", "wheel.fl.duty_pct"}
    assert not cuts([])


@pytest.mark.parametrize(
    ("log", "stage", "cause", "course"),
    [
        (("drive", 50.0, 240.0), "pose", "gyro_bias", (-0.008, 0.012)),
        (("bench", 100.0, 60.0), "drive", "process_gain", (0.0, -0.05)),
    ],
)
def test_a_course_follows_a_parameter_that_drifts(log, stage, cause, course):
    one = stages_of(*log, (cause, course[1]), drift_from={cause: course[0]})[stage]
    candidate = next(c for c in one.library.candidates if c.cause == cause)
    point = fit(one.problem, Model().plus(candidate, candidate.beginning), one.base)
    assert courses(one.problem, point, set()) == []
    assert courses(one.problem, one.base, {cause}) == []
    (found,) = courses(one.problem, point, {cause})
    assert found.cause == cause
    assert 6 <= len(found.t_s) <= 10
    assert (np.diff(found.t_s) > 0.0).all()
    truth = np.interp(found.t_s, [0.0, log[2]], course)
    assert found.value == pytest.approx(truth, abs=0.1 * abs(course[1] - course[0]))
    assert np.mean((found.low <= truth) & (truth <= found.high)) >= 0.7
    assert (found.high - found.low < 0.5 * abs(course[1] - course[0])).all()


def unknown(stage):
    problem, base = stage.problem, stage.base
    return remaining(
        problem, base, np.random.default_rng(0), families_of(problem, base), 0.0
    )


def test_what_swings_is_folded_over_its_period():
    periodic = (
        ("periodic.turn", 0.05),
        ("periodic.period", 8.0),
        ("periodic.phase", 0.3),
    )
    one = stages_of(*DRIVE, *periodic)["pose"]
    found = dependences(one.problem, one.base, unknown(one))
    (d,) = (d for d in found if d.regressor.startswith("t_s mod"))
    assert d.channel == "imu.gyro_z_rad_s"
    assert float(d.regressor.split()[-1]) == pytest.approx(8.0, rel=0.03)
    assert d.mean.max() - d.mean.min() == pytest.approx(0.1, rel=0.25)
    assert (d.low < d.mean).all()
    assert (d.mean < d.high).all()
    assert d.statistic > d.critical > 2.0


def test_what_goes_astray_is_told_as_a_speed():
    drag = (("cable_drag.speed", 0.2), ("cable_drag.phase", 0.3))
    one = stages_of("drive", 50.0, 240.0, *drag)["pose"]
    found = dependences(one.problem, one.base, unknown(one))
    d = found[0]
    assert (d.channel, d.unit, d.regressor) == (
        "velocity.linear_m_s",
        "m/s",
        "nav.yaw_rad",
    )
    assert (d.low > 0.0).any()
    assert (d.high < 0.0).any()


def test_of_the_drive_the_disturbed_wheel_is_drawn():
    talk = (
        ("cross_talk.share", 0.12),
        ("cross_talk.from", 0.0),
        ("cross_talk.to", 3.0),
    )
    one = stages_of("bench", 100.0, 60.0, *talk)["drive"]
    assert dependences(one.problem, one.base, []) == []
    d = dependences(one.problem, one.base, unknown(one))[0]
    assert d.channel == "wheel.rr.duty_pct"
    assert d.regressor.startswith("wheel.fl.")
    slope = np.polyfit(d.x, d.mean, 1)[0]
    assert slope == pytest.approx(-0.12 / assembly().robot.process.gain, rel=0.2)

"""Parts of the evidence on their own: the replay of the process, and means in bins."""

from dataclasses import replace

import numpy as np
import pytest

from hilserver.diagnosis.replay.drive_stage import DriveStage
from hilserver.diagnosis.report.dependence import binned
from hilserver.measured.channels import DUTIES, SETPOINTS, SPEEDS
from hilserver.measured.data import Channel, LogSource, MeasuredLog, Span
from hilserver.plant.parameters import RobotParameters

DURATION_S = 6.0


def log(setpoint_rpm):
    """Steps of the set-points, and speeds and duties that nobody looks at."""
    t = np.arange(0.0, DURATION_S, 0.02)
    span = np.zeros(len(t), dtype=np.int64)
    steps = setpoint_rpm * np.sign(np.sin(2.0 * np.pi * t / 3.0))
    names = dict.fromkeys(SETPOINTS, steps) | dict.fromkeys((*SPEEDS, *DUTIES), 0.0 * t)
    return MeasuredLog(
        (LogSource("toy.csv", ""),),
        {n: Channel(t, v, span) for n, v in names.items()},
        (Span(0, None, 0.0, float(t[-1])),),
    )


@pytest.mark.parametrize(
    "terms",
    [
        {},
        {"coulomb_friction": 1.5, "dead_zone": 2.0},
        {"viscous_load": 0.05},
        {"encoder_filter": 0.01, "encoder_quantization": 0.5},
        {"actuation_delay": 0.04, "saturation_limit": 50.0, "controller_gains.p": -0.3},
    ],
    ids=str,
)
def test_the_process_alone_under_the_chains_duty_runs_as_the_chain_does(terms):
    """Whatever terms the configured plant has: the cut takes nothing away but the controller."""
    stage = DriveStage(log(40.0), replace(RobotParameters(), terms=terms), block_s=1.0)
    _, seen, duty = stage.simulate({})
    assert np.abs(seen).max() > 10.0
    np.testing.assert_allclose(stage.process_only(duty), seen, rtol=0.0, atol=1e-9)


def test_inputs_rest_from_their_last_change():
    stage = DriveStage(log(40.0), RobotParameters(), block_s=1.0)
    since = stage.since(stage.stepped(2))
    changes = np.flatnonzero(since == 0.0) * stage.segments.period_s
    assert changes == pytest.approx([0.02, 1.52, 3.02, 4.52], abs=0.021)
    assert since.min() == 0.0
    assert since[np.isfinite(since)].max() == pytest.approx(1.5, abs=0.05)
    assert np.isinf(since[0])
    still = log(40.0)
    t, span = still[SETPOINTS[2]].t_s, still[SETPOINTS[2]].span
    one = DriveStage(
        still.with_channels({SETPOINTS[2]: Channel(t, 0.0 * t, span)}),
        RobotParameters(),
        block_s=1.0,
    )
    assert not one.stepped(2).any()
    assert (one.stepped(1) == stage.stepped(1)).all()
    assert np.isinf(stage.since(np.zeros(len(since), dtype=bool))).all()


def test_the_interval_of_a_bin_counts_blocks_not_samples():
    """Errors that hold through a block: the interval holds zero in 95 of 100 cases all the same."""
    rng = np.random.default_rng(4)
    inside = []
    for _ in range(300):
        block = np.repeat(np.arange(20), 50)
        residual = np.repeat(rng.standard_normal(20), 50) + 0.1 * rng.standard_normal(
            1000
        )
        for _, mean, half in binned(rng.uniform(0.0, 1.0, 1000), residual, block, 4):
            inside.append(abs(mean) <= half)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.03)


def test_a_bin_of_few_blocks_is_left_out():
    x = np.array([0.0, 0.1, 0.0, 0.1, 0.05, 1.0, 1.0])
    found = binned(x, x, np.array([0, 0, 1, 1, 2, 2, 2]), 2)
    assert [middle for middle, *_ in found] == [pytest.approx(0.05)]
    assert binned(np.ones(5), np.ones(5), np.arange(5), 4) == []
    assert binned(np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.int64), 4) == []

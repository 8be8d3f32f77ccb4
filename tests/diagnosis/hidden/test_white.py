"""A log of a sound machine leaves nothing but what its sensors add, at any rate of the log."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hilserver_injector import Noise, make, nothing
from scipy import stats

from benchmarks.diagnose_worker import measured
from hilserver.diagnosis.regression.stages import prepare, stages_of
from tests.diagnosis.hidden.logs import assembly

LAGS = (1, 2, 3, 5, 10, 20)
LOGS = [("drive", 20.0, 300.0), ("drive", 50.0, 150.0), ("bench", 50.0, 150.0),
        ("bench", 500.0, 15.0), ("drive", 500.0, 60.0)]  # fmt: skip
DRIVEN = ("speed_rpm", "duty_pct")


@cache
def prepared(kind, rate_hz, duration_s, t1=1.0):
    made = nothing(kind, 11)
    recorder = replace(made.taken, rate_hz=rate_hz)
    made = replace(made, duration_s=duration_s, recorder=recorder)
    log = measured(make(made)[0], made)
    robot = assembly().robot
    robot = replace(robot, process=replace(robot.process, t1_s=t1 * robot.process.t1_s))
    stages = stages_of(log, robot)
    return {name: prepare(stage, 1, lambda *_: None)[0] for name, stage in stages.items()}


def correlations(problem, left, channel):
    """Correlation at some lags inside segments, and Ljung and Box's sum of their squares."""
    runs = [left[part] for name, _, part in problem.stack.runs() if name == channel]
    power = sum(r @ r for r in runs)
    rho = np.array([sum(r[k:] @ r[:-k] for r in runs) for k in LAGS]) / power
    return rho, sum(map(len, runs)) * float(rho @ rho)


def test_the_noise_is_the_injectors():
    """What the sensors add is known: the fitted noise is that, and no error of the replay."""
    noise = Noise()
    drive = prepared(*LOGS[0])
    fitted = {**drive["drive"].problem.noise, **drive["pose"].problem.noise}
    bench = prepared(*LOGS[3])["drive"].problem.noise
    wanted = {"speed_rpm": noise.speed_rpm, "duty_pct": noise.duty_pct, "gyro_z": noise.gyro_rad_s}
    for name, model in (*fitted.items(), *bench.items()):
        for part, sd in wanted.items():
            if part in name:
                assert model.sd == pytest.approx(sd, rel=0.04), name
    for name in ("nav.x_m", "nav.y_m"):
        assert fitted[name].ou_sd == pytest.approx(noise.position_m, rel=0.15)
        assert fitted[name].ou_tau_s == pytest.approx(noise.position_correlation_s, rel=0.3)
    assert fitted["nav.yaw_rad"].sd == pytest.approx(noise.yaw_rad, rel=0.2)


@pytest.mark.parametrize("log", LOGS, ids=str)
def test_whitened_residuals_have_unit_size_and_no_memory(log):
    judged = 0
    for stage in prepared(*log).values():
        problem, left = stage.problem, stage.base.left
        squares = {}
        for channel in problem.stack.channels:
            mine = left[problem.stack.edges[channel]]
            kept = mine[problem.weights[problem.stack.edges[channel]] > 0.0]
            kind = channel if stage.problem.stage.name == "pose" else channel.rpartition(".")[2]
            squares.setdefault(kind, []).append(np.mean(kept**2))
            rho, total = correlations(problem, left, channel)
            assert np.abs(rho).max() < 4.5 / np.sqrt(len(mine)), (channel, rho)
            assert total < stats.chi2.ppf(0.9999, len(LAGS)), (channel, rho)
            judged += 1
        for kind, values in squares.items():
            # the drive's noise is told from neighbours, 3 % for all wheels and 8 % for one
            assert np.mean(values) == pytest.approx(1.0, abs=0.03), kind
            assert values == pytest.approx([1.0] * len(values), abs=0.08), kind
    assert judged == (12 if log[0] == "drive" else 8)


def test_a_plant_that_is_a_little_wrong_does_not():
    stage = prepared("bench", 500.0, 15.0, t1=1.02)["drive"]
    worst = max(
        correlations(stage.problem, stage.base.left, channel)[1]
        for channel in stage.problem.stack.channels
    )
    assert worst > 10.0 * stats.chi2.ppf(0.9999, len(LAGS))

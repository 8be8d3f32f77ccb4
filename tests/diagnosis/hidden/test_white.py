"""A log of a sound machine leaves nothing but what its sensors add, at any rate of the log."""

from dataclasses import replace

import numpy as np
import pytest
from hilserver_injector import Noise, nothing
from scipy import stats

from hilserver.diagnosis.report.cuts import cuts
from hilserver.diagnosis.report.words import where
from tests.diagnosis.hidden.logs import assembly, prepared

LAGS = (1, 2, 3, 5, 10, 20)
LOGS = [("drive", 20.0, 300.0), ("drive", 50.0, 150.0), ("bench", 50.0, 150.0),
        ("bench", 500.0, 15.0), ("drive", 500.0, 60.0)]  # fmt: skip


def stages_of(kind, rate_hz, duration_s, t1=1.0):
    made = nothing(kind, 11)
    recorder = replace(made.taken, rate_hz=rate_hz)
    made = replace(made, duration_s=duration_s, recorder=recorder)
    robot = assembly().robot
    robot = replace(robot, process=replace(robot.process, t1_s=t1 * robot.process.t1_s))
    return prepared(made, robot)


@pytest.fixture(scope="module", params=LOGS, ids=str)
def log(request):
    """One log after the other, for all tests: all at once would take more than a gigabyte."""
    return request.param


@pytest.fixture(scope="module")
def stages(log):
    return stages_of(*log)


def correlations(problem, left, channel):
    """Correlation at some lags inside segments, and Ljung and Box's sum of their squares."""
    runs = [left[part] for name, _, part in problem.stack.runs() if name == channel]
    power = sum(r @ r for r in runs)
    rho = np.array([sum(r[k:] @ r[:-k] for r in runs) for k in LAGS]) / power
    return rho, sum(map(len, runs)) * float(rho @ rho)


def test_the_noise_is_the_injectors(log, stages):
    """What the sensors add is known: the fitted noise is that, and no error of the replay."""
    noise = Noise()
    wanted = {
        "speed_rpm": noise.speed_rpm,
        "duty_pct": noise.duty_pct,
        "gyro_z": noise.gyro_rad_s,
    }
    fitted = {
        name: m for stage in stages.values() for name, m in stage.problem.noise.items()
    }
    for name, model in fitted.items():
        for part, sd in wanted.items():
            if part in name:
                assert model.sd == pytest.approx(sd, rel=0.04), name
    if log[0] == "bench":
        return
    fewer = np.sqrt(300.0 / log[2])  # independent positions
    for name in ("nav.x_m", "nav.y_m"):
        assert fitted[name].ou_sd == pytest.approx(noise.position_m, rel=0.15 * fewer)
        tau_s = noise.position_correlation_s
        assert fitted[name].ou_tau_s == pytest.approx(tau_s, rel=0.3 * fewer)
    assert fitted["nav.yaw_rad"].sd == pytest.approx(noise.yaw_rad, rel=0.2)


def test_whitened_residuals_have_unit_size_and_no_memory(log, stages):
    judged = 0
    for stage in stages.values():
        problem, left = stage.problem, stage.base.left
        squares = {}
        for channel in problem.stack.channels:
            mine = left[problem.stack.edges[channel]]
            kept = mine[problem.weights[problem.stack.edges[channel]] > 0.0]
            kind = (
                channel
                if stage.problem.stage.name == "pose"
                else channel.rpartition(".")[2]
            )
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


def test_from_every_cut_point_all_residuals_are_the_sensors_noise(log, stages):
    rows = cuts(stages.values())
    assert len(rows) == (12 + 4 + 4 if log[0] == "drive" else 8 + 4)
    for row in rows:
        # few independent samples, and noise that is fitted
        slow = row.channel.startswith("nav.")
        assert row.rms / row.expected == pytest.approx(
            1.0, abs=0.2 if slow else 0.06
        ), row
    assert where(rows) == ""


def test_a_plant_that_is_a_little_wrong_does_not():
    stage = stages_of("bench", 500.0, 15.0, t1=1.02)["drive"]
    worst = max(
        correlations(stage.problem, stage.base.left, channel)[1]
        for channel in stage.problem.stack.channels
    )
    assert worst > 10.0 * stats.chi2.ppf(0.9999, len(LAGS))

"""A rounded gyro of a robot that does not turn: most of its readings are one value."""

import math

import numpy as np
import pytest
from hilserver_injector import make
from hilserver_injector.cases import cases

from benchmarks.diagnose_worker import measured
from hilserver.diagnosis.regression.problem import Problem
from hilserver.diagnosis.regression.stages import stages_of
from hilserver.measured.channels import DUTIES, GYRO, SETPOINTS, SPEEDS
from hilserver.plant.parameters import RobotParameters


@pytest.mark.parametrize("seed", [700, 3003])
def test_no_reading_is_truer_than_its_rounding(seed):
    (recipe,) = [
        c.recipe for c in cases("sensors", range(seed, seed + 1)) if c.name == "stand"
    ]
    log = measured(make(recipe)[0]).without([*DUTIES, *SETPOINTS])
    still = {name: log[name].with_values(np.zeros(len(log[name]))) for name in SPEEDS}
    log = log.with_channels(still)
    problem = Problem(stages_of(log, RobotParameters())["pose"])
    problem.estimate_noise(
        problem.residual(problem.predict({}, problem.start_poses({})))
    )
    step, true_sd = recipe.sensors["gyro_z"].step, recipe.noise.gyro_rad_s
    whole = math.hypot(true_sd, step / math.sqrt(12.0))
    assert problem.noise[GYRO].sd == pytest.approx(whole, rel=0.2)

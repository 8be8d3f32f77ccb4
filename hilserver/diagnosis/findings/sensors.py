"""What the channels show: noise, resolution and limits, as findings.json has them."""

import numpy as np

from hilserver.diagnosis.regression.problem import Problem
from hilserver.diagnosis.schema.findings import Noise


def noise_of(problem: Problem) -> dict[str, Noise]:
    """Return noise, resolution and limits of every channel of a stage."""
    found = {}
    for name, model in problem.noise.items():
        reading = problem.readings[name]
        found[name] = Noise(
            white_sd=float(model.white_sd),
            ou_sd=float(model.ou_sd),
            ou_tau_s=float(model.ou_tau_s) if model.ou_sd > 0.0 else None,
            tail_dof=float(model.tail_dof) if np.isfinite(model.tail_dof) else None,
            step=float(reading.step) if reading.step > 0.0 else None,
            limits=(-float(reading.limit), float(reading.limit))
            if np.isfinite(reading.limit)
            else None,
        )
    return found

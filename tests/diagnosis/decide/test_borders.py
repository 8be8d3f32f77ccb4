"""A fit at the border of a cause's range asks the plant for nothing that it refuses."""

import numpy as np
import pytest

from hilserver.diagnosis.catalogue.library import drive_candidates, pose_candidates
from hilserver.diagnosis.replay.model import Model
from hilserver.plant.terms import complete
from tests.diagnosis import toy

CANDIDATES = [*drive_candidates(), *pose_candidates((-2.0, 2.0, -2.0, 2.0))]


def asked_for(candidate, at):
    """Return the terms that the sensitivities of a model at the border are computed from."""
    asked = []

    class Stage(toy.LinearStage):
        def predict(self, terms, *rest, **how):
            asked.append(terms)
            return np.zeros(len(self.stack))

    problem = toy.Problem(Stage(np.zeros(200), {}))
    problem.noise = {toy.SIGNAL: toy.NoiseModel(1.0)}
    model = Model().plus(candidate, at)
    problem.columns(problem.point(model, np.zeros((0, 3))), model)
    return asked


def borders():
    """All candidates with each of their borders that is not at infinity."""
    for candidate in CANDIDATES:
        for name, at in (("low", candidate.low), ("high", candidate.high)):
            if np.isfinite(at).all():
                yield pytest.param(candidate, at, id=f"{candidate.label}, {name}")


@pytest.mark.parametrize(("candidate", "at"), list(borders()))
def test_no_sensitivity_leaves_what_the_plant_accepts(candidate, at):
    asked = asked_for(candidate, at)
    assert len(asked) == 1 + candidate.n
    for terms in asked:
        complete({name: value for name, value in terms.items() if "shift." not in name})

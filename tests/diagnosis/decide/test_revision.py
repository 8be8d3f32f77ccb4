"""What becomes of causes that lose their names."""

from dataclasses import replace

import numpy as np
import pytest

from hilserver.diagnosis.decide.revision import revised
from hilserver.diagnosis.decide.selection import select
from hilserver.diagnosis.decide.unknown import Family
from hilserver.diagnosis.regression.stages import Prepared
from tests.diagnosis import toy

N = 4000


@pytest.mark.parametrize(
    ("least", "changes", "causes", "is_unknown"),
    [
        (0.9, False, ("c",), False),
        (1.1, False, (), False),  # it has a name, and is too small for it
        (1.1, True, (), True),  # its mean does not say how large it is
    ],
)
def test_a_cause_too_small_for_its_name_is_no_unknown_structure(
    monkeypatch, least, changes, causes, is_unknown
):
    rng = np.random.default_rng(3)
    column = 5.0 * toy.smooth(rng, N)
    size = 0.2 + np.linspace(-3.0, 3.0, N) if changes else 1.0
    values = size * column + rng.normal(size=N)
    family = Family("turn", ("t_s",), (size * column)[:, None])
    monkeypatch.setattr("hilserver.diagnosis.decide.revision.families_of", lambda *_: [family])
    problem = toy.problem(values, {"c": column})
    library, base = toy.library(problem)
    library.candidates[:] = [replace(library.candidates[0], least=least)]
    found = revised(Prepared(problem, library, base), select(problem, library, base, rng), rng)
    assert found.point.model.causes == causes
    assert bool(found.unknown) == is_unknown

"""The smallest effect that would have been seen, and what a drive hardly shows."""

import numpy as np
import pytest

from hilserver.diagnosis.findings.detectable import smallest_of
from hilserver.diagnosis.replay.judgeable import UNSEEN
from tests.diagnosis import toy

N = 3000


@pytest.mark.parametrize(
    ("shown", "says"),
    [(0.3, "hardly excited: below"), (1e-4, UNSEEN)],
    ids=["hardly", "not"],
)
def test_no_size_is_said_that_no_machine_has(shown, says):
    """It used to say: below 1.23e+09 1 it would not be detected."""
    rng = np.random.default_rng(2)
    column = shown * toy.smooth(rng, N)
    problem = toy.problem(rng.normal(size=N), {"process_gain": column})
    library, base = toy.library(problem)
    sizes, unseen = smallest_of([(library, base)], rng)
    assert sizes == []
    (reason,) = [one.reason for one in unseen]
    assert reason.startswith(says)

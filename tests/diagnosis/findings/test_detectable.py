"""The smallest effect that would have been seen, and what a drive hardly shows."""

from dataclasses import replace

import numpy as np
import pytest

from hilserver.diagnosis.findings.detectable import smallest, smallest_of
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


def test_the_size_of_a_cause_with_shapes_is_one_that_nearly_all_of_them_show():
    """It used to be that of the clearest wavelength, or of the best edge of a floor."""
    rng = np.random.default_rng(3)
    strengths = {"a": 100.0, "b": 70.0, "c": 50.0, "d": 25.0, "e": 1.0}
    smooth = toy.smooth(rng, N)
    problem = toy.problem(
        rng.normal(size=N), {name: size * smooth for name, size in strengths.items()}
    )
    library, base = toy.library(problem, hidden=dict.fromkeys(strengths, 1))
    for cause, expected in (("nav_position_bias", 25.0), ("process_gain", 100.0)):
        hidden = int(cause == "nav_position_bias")
        library.candidates[:] = [
            replace(c, cause=cause, hidden=hidden) for c in library.candidates
        ]
        scores = library.scores(base)
        (size,), _ = smallest(library, scores, 4.0)
        only = np.flatnonzero([s == expected for s in strengths.values()])[0]
        visible = scores.information[only] / scores.deviation[only]
        assert size.size * visible == pytest.approx(6.7, abs=0.3)

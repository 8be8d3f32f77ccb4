"""What unknown structure is looked for in."""

from types import SimpleNamespace

import numpy as np
import pytest

from hilserver.diagnosis.decide.unknown import peaks


def residuals(*lengths, rate_hz=20.0, at_hz=0.7):
    """A problem with one channel per length, each with a tone."""
    names = [f"channel {k}" for k in range(len(lengths))]
    begins = np.cumsum([0, *lengths[:-1]])
    edges = {n: slice(a, a + k) for n, a, k in zip(names, begins, lengths, strict=True)}
    t_s = np.concatenate([np.arange(k) / rate_hz for k in lengths])
    residual = np.sin(2.0 * np.pi * at_hz * t_s)
    stack = SimpleNamespace(t_s=t_s, edges=edges)
    problem = SimpleNamespace(stack=stack, residual=lambda _: residual)
    return names, problem


@pytest.mark.parametrize(
    "lengths", [(4000, 4000), (4000, 3900), (3900, 4000), (50, 4000)]
)
def test_the_strongest_frequency_of_channels_that_end_at_different_times(lengths):
    names, problem = residuals(*lengths)
    found = peaks(problem, SimpleNamespace(predicted=None), names)
    assert found[0] == pytest.approx(0.7, abs=0.01)


def test_channels_too_short_have_none():
    names, problem = residuals(150, 10)
    assert peaks(problem, SimpleNamespace(predicted=None), names) == ()

"""The columns of all candidates, laid out for the screen."""

import numpy as np

from hilserver.diagnosis.regression.columns import SQUARE, lay_out


def test_two_parameters_are_looked_at_from_four_sides():
    rng = np.random.default_rng(6)
    table = rng.normal(size=(500, 3)) * [1.0, 1.0, 1e4]
    pair, order = table[:, 1:], rng.permutation(500)
    length = np.array([1.0, *np.linalg.norm(pair, axis=0)])
    place, weight = np.array([0, 1, 1, 1, 1]), np.array([SQUARE[0], *SQUARE])
    out = np.empty((500, 5))
    lay_out(table, length, place, weight, order, out)
    assert np.array_equal(out[:, 0], table[order, 0]), "one parameter keeps its unit"
    four = np.empty((500, 4))
    four[order] = out[:, 1:]
    unit = pair / np.linalg.norm(pair, axis=0)
    for angle in np.linspace(0.0, np.pi, 9):
        mixed = unit @ [np.cos(angle), np.sin(angle)]
        cosine = (
            np.abs(four.T @ mixed)
            / np.linalg.norm(four, axis=0)
            / np.linalg.norm(mixed)
        )
        assert cosine.max() > 0.9, (
            "no direction of the plane is further than 22.5 degrees"
        )

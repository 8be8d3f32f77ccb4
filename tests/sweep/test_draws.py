"""Draws are functions of seed, index and name, and follow their distributions."""

import numpy as np
import pytest
from scipy import stats

from hilserver.sweep.draws import Draws, JointDraw, root_of
from hilserver.sweep.model import Distribution, FaultShare

UNIFORM = Distribution(uniform=(2.0, 6.0))
NORMAL = Distribution(sd=0.5)
COVARIANCE = np.array([[4.0, -1.5], [-1.5, 1.0]])


def draws(seed=1, faults=(), joint=None, **population):
    return Draws(seed, population, dict.fromkeys(population, 10.0), joint, faults)


def column(of, name, n=3000):
    return np.array([of.values(index)[name] for index in range(n)])


def test_another_parameter_changes_nothing():
    alone, beside = draws(a=NORMAL), draws(b=UNIFORM, a=NORMAL)
    assert alone.values(4711)["a"] == beside.values(4711)["a"]
    assert alone.plant_seed(4711) == beside.plant_seed(4711)


def test_machines_seeds_and_names_differ():
    assert len({draws(a=UNIFORM).values(i)["a"] for i in range(100)}) == 100
    assert draws(a=UNIFORM).values(3) != draws(seed=2, a=UNIFORM).values(3)
    both = draws(a=UNIFORM, b=UNIFORM)
    assert abs(np.corrcoef(column(both, "a"), column(both, "b"))[0, 1]) < 0.06


def test_distributions():
    assert (
        stats.kstest(column(draws(a=UNIFORM), "a"), "uniform", (2.0, 4.0)).pvalue > 1e-3
    )
    assert stats.kstest(column(draws(a=NORMAL), "a"), "norm", (10.0, 0.5)).pvalue > 1e-3
    of_three = column(draws(a=Distribution(values=(1.0, 2.0, 5.0))), "a")
    assert stats.chisquare(np.unique(of_three, return_counts=True)[1]).pvalue > 1e-3


def test_what_is_known_together_is_drawn_together():
    joint = JointDraw(("x", "y"), np.array([1.0, -2.0]), root_of(COVARIANCE))
    of = draws(joint=joint, a=NORMAL)
    assert of.names == ("x", "y", "a")
    found = np.stack([column(of, "x", 6000), column(of, "y", 6000)])
    assert found.mean(axis=1) == pytest.approx([1.0, -2.0], abs=0.1)
    assert np.cov(found) == pytest.approx(COVARIANCE, abs=0.2)


def test_a_covariance_without_rank_is_one():
    root = root_of(np.ones((2, 2)))
    assert root @ root.T == pytest.approx(np.ones((2, 2)))


@pytest.mark.parametrize(
    ("matrix", "says"),
    [([[1.0, 2.0], [2.0, 1.0]], "positive"), ([[1.0, 0.5], [0.0, 1.0]], "symmetric")],
)
def test_what_is_no_covariance_is_refused(matrix, says):
    with pytest.raises(ValueError, match=says):
        root_of(np.array(matrix))


def test_a_share_of_the_machines_has_a_fault_with_a_seed_of_its_own():
    fault = {"fault": "noise", "signal": "imu.gyro_z_rad_s", "sd": 0.1}
    of = draws(faults=[FaultShare(share=0.25, fault=fault)])
    found = [fault for index in range(2000) for _, fault in of.faults_of(index)]
    assert len(found) == pytest.approx(500, abs=80)
    assert len({fault.seed for fault in found}) > 490

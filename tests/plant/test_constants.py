"""The constants of a tick: what Python computes and what is compiled are the same bits."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilserver.compiled import kernel
from hilserver.fmu.variables import tunables
from hilserver.plant.constants import compute
from hilserver.plant.errors import PlantError
from hilserver.plant.layout import Parameters
from hilserver.plant.packing import pack
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.physical import FITS, REASONS, Physical, physical

ROBOTS = (
    RobotParameters(),
    RobotParameters(drive="mecanum", icr_offset_m=0.0, terms={"control_period": 0.004}),
    RobotParameters(
        discretization="euler", wheelbase_m=None, terms={"setpoint_rate_limit": 100.0}
    ),
)


@kernel()
def compiled(v, p):
    return compute(v, p)


def record_of(v):
    record = Physical.zeros()
    for name, value in vars(v).items():
        record[name] = value
    return record


@st.composite
def numbers(draw):
    """A robot with some numbers anywhere in their range, most of them near what is usual."""
    robot = draw(st.sampled_from(ROBOTS))
    v = record_of(physical(robot))
    for tunable in draw(st.lists(st.sampled_from(tunables(robot)), max_size=12)):
        usual = abs(tunable.start) or 0.1
        near = st.floats(max(tunable.low, -2 * usual), min(tunable.high, 2 * usual))
        v.numbers[tunable.place] = draw(near | st.floats(tunable.low, tunable.high))
    return v


@given(numbers())
def test_compiled_they_are_the_bits_that_python_computes(v):
    ours, theirs = Parameters.zeros(), Parameters.zeros()
    with np.errstate(all="ignore"):
        code = compute(v, ours)
    assert compiled(v, theirs) == code
    assert code in {FITS, *REASONS}
    if code == FITS:
        assert ours.numbers.tobytes() == theirs.numbers.tobytes()


@pytest.mark.parametrize("robot", ROBOTS)
def test_all_of_them_are_computed(robot):
    p = Parameters.of(np.full(Parameters.n_words, math.nan))
    assert compute(physical(robot), p) == FITS
    assert not np.isnan(p.numbers).any()
    assert p.numbers.tobytes() == pack(robot).numbers.tobytes()


@pytest.mark.parametrize(
    "terms",
    [{"actuation_delay": 2.0}, {"wheel_load.wheel": 1.5}, {"control_period": 1e-4}],
    ids=str,
)
def test_what_does_not_fit_is_named(terms):
    (name,) = terms
    with pytest.raises(PlantError, match=f"^plant.terms.{name}: "):
        pack(RobotParameters(terms=terms))

"""Numbers that strangers write: a double must be able to hold them."""

import math

from hypothesis import given
from hypothesis import strategies as st

from hilserver.signals.numbers import is_finite_number

ANYTHING = (
    st.none()
    | st.booleans()
    | st.text()
    | st.integers()
    | st.floats()
    | st.lists(st.none())
)


@given(ANYTHING)
def test_what_passes_is_a_finite_double(value):
    if is_finite_number(value):
        assert math.isfinite(float(value))


def test_booleans_and_endless_integers_do_not_pass():
    given = (1, 0.5, -(10**300), True, "1", math.nan, math.inf, 10**400, None)
    assert list(map(is_finite_number, given)) == [True] * 3 + [False] * 6

"""Our way through numba's compiler makes what numba makes; a part has no entry for Python."""

import numba
import numpy as np
import pytest

from hilserver.compiled import part
from hilserver.compiled.stored import Pipeline


def built(**options):
    """Return a function with helpers in helpers, in branches, in a loop, twice in a row."""

    @numba.njit(inline="always", **options)
    def clipped(x, top):
        if x > top:
            return top
        return x

    @numba.njit(inline="always", **options)
    def total(values, top):
        found = 0.0
        for i in range(values.shape[0]):
            found += clipped(values[i], top) - clipped(-values[i], top)
        return found

    @numba.njit(**options)
    def outer(values, top):
        if top > 1.0:
            return total(values, top) + total(values, 2.0 * top)
        return clipped(total(values, top), 0.5)

    return outer


def test_it_gives_the_code_that_numba_gives():
    args = np.array([0.5, -3.0, 2.0]), 1.5
    codes = []
    for options in ({}, {"pipeline_class": Pipeline}):
        outer = built(**options)
        assert outer(*args) == outer.py_func(*args)
        (compiled,) = outer.overloads.values()
        blocks = [block for defined in functions(compiled) for block in defined.blocks]
        codes.append([[one.opcode for one in block.instructions] for block in blocks])
    assert codes[0] == codes[1]


@pytest.fixture
def doubled():
    @part
    def doubled(x):
        x[0] *= 2.0
        return x[0]

    return doubled


def test_a_part_has_no_entries_until_python_calls_it(doubled):
    @numba.njit
    def caller(x):
        return doubled(x) + 1.0

    x = np.array([1.0])
    assert caller(x) == 3.0
    (inside,) = doubled.overloads.values()
    names = [defined.name for defined in functions(inside)]
    assert not any("cpython" in name or "cfunc" in name for name in names)
    assert doubled(x) == 4.0
    assert doubled(x) == 8.0
    assert caller(x) == 17.0
    assert list(doubled.overloads.values()) == [inside]


def functions(compiled):
    return list(compiled.library.get_defined_functions())

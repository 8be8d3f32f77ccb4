"""Whatever JSON a browser sends: it fits the type that is wanted, or there is one sentence."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilserver.io.opcua_server.method_table import METHODS, STRING
from hilserver.io.page.calls import WrongTypeError, check, fit
from hilserver.io.page.hand import RefusedError, _arguments

SCALARS = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text()
    | st.just("\ud800")
)
JSON = (
    SCALARS
    | st.lists(SCALARS, max_size=3)
    | st.dictionaries(st.text(), SCALARS, max_size=3)
)


@given(st.sampled_from(METHODS), st.lists(JSON, max_size=3))
def test_what_passes_becomes_variants_that_can_be_sent(method, given_):
    try:
        check(method.name, given_, [a.type for a in method.arguments])
    except WrongTypeError:
        return
    try:
        variants = _arguments(method, given_)
    except RefusedError:
        pytest.fail("it passed and does not fit")
    for argument, variant in zip(method.arguments, variants, strict=True):
        if argument.type == STRING:
            variant.Value.encode()


@pytest.mark.parametrize(
    ("kind", "good", "bad"),
    [
        ("Byte", [0, 255, 3.0], [-1, 256, 1.5, "1", None, True]),
        ("UInt32", [2**32 - 1], [-1, 2**32]),
        ("Double", [-1, 1e300], [float("nan"), float("inf"), 10**400, "1", [], False]),
        ("Boolean", [True, 0, 1.0], [2, "true", None, [1]]),
        (STRING, ["", "a.csv", 1], [None, True, {}, "\ud800"]),
    ],
)
def test_types(kind, good, bad):
    assert all(fit(value, kind) for value in good)
    assert not any(fit(value, kind) for value in bad)

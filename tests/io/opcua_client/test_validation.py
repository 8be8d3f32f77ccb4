"""What a sample or a sequence number is worth."""

import math

import pytest
from asyncua import ua
from hypothesis import given
from hypothesis import strategies as st

from hilserver.io.opcua_client.link import PeerLink
from hilserver.io.opcua_client.session import judge
from hilserver.io.opcua_client.writer import variant
from hilserver.io.peer_link.link import Backoff
from hilserver.io.peer_link.samples import FaultKind, LinkLostError, SequenceWatch


def sample(
    value: object, kind: ua.VariantType | None = None, status: int = 0
) -> ua.DataValue:
    return ua.DataValue(
        ua.Variant(value, kind), StatusCode=ua.StatusCode(ua.UInt32(status))
    )


@given(st.floats(allow_nan=True, allow_infinity=True))
def test_only_finite_numbers_pass(number):
    verdict = judge(sample(number))
    if math.isfinite(number):
        assert (verdict.value, verdict.fault) == (number, None)
    else:
        assert (verdict.value, verdict.fault) == (None, FaultKind.NOT_FINITE)


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        (sample("12.5"), FaultKind.TEXT_IN_NUMBER),
        (sample(b"12"), FaultKind.TEXT_IN_NUMBER),
        (sample([1.0, math.nan]), FaultKind.NOT_FINITE),
        (sample([1.0, "2"], ua.VariantType.Variant), FaultKind.TEXT_IN_NUMBER),
        (sample(None), FaultKind.NO_VALUE),
        (ua.DataValue(None), FaultKind.NO_VALUE),
        (sample(1.0, status=ua.StatusCodes.BadSensorFailure), FaultKind.BAD_STATUS),
        (
            sample(1.0, status=ua.StatusCodes.UncertainLastUsableValue),
            FaultKind.BAD_STATUS,
        ),
        (sample(None, status=ua.StatusCodes.BadNodeIdUnknown), FaultKind.MISSING_NODE),
    ],
)
def test_what_cannot_be_used_is_named(data, fault):
    verdict = judge(data)
    assert (verdict.value, verdict.fault) == (None, fault)
    assert verdict.detail


@pytest.mark.parametrize("value", [True, 3, -2.5, [1.0, 2.0, 3.0, 4.0]])
def test_what_can_be_used_keeps_its_type(value):
    verdict = judge(sample(value))
    assert verdict.value == value
    assert type(verdict.value) is type(value)


@given(
    start=st.integers(0, 2**32 - 1),
    lost=st.lists(st.integers(0, 50), min_size=1, max_size=30),
)
def test_missed_numbers_are_counted_also_over_the_wrap(start, lost):
    watch, number, missed = SequenceWatch(), start, 0
    assert watch.observe(number).advanced
    for gap in lost:
        number = (number + 1 + gap) % 2**32
        step = watch.observe(number)
        assert step.advanced
        missed += step.missed
        assert not watch.observe(number).advanced
    assert missed == sum(lost)


def test_a_counter_that_starts_anew_is_a_jump_not_a_loss():
    watch = SequenceWatch()
    watch.observe(5000)
    step = watch.observe(1)
    assert (step.advanced, step.missed, step.fault) == (
        True,
        0,
        FaultKind.SEQUENCE_JUMP,
    )


def test_backoff_doubles_up_to_its_limit_and_begins_anew():
    backoff = Backoff(first_s=0.1, limit_s=1.0)
    assert [backoff.next_s() for _ in range(6)] == [0.1, 0.2, 0.4, 0.8, 1.0, 1.0]
    backoff.settled()
    assert backoff.next_s() == 0.1


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (LinkLostError("the subscription went silent"), "the subscription went silent"),
        (TimeoutError(), "no answer in time"),
        (ConnectionRefusedError(), "nothing is listening there"),
        (ExceptionGroup("g", [TimeoutError()]), "no answer in time"),
        (ua.uaerrors.BadTooManySessions(), "the peer answered BadTooManySessions"),
        (ValueError("odd bytes"), "ValueError: odd bytes"),
    ],
)
def test_every_end_has_words(error, text):
    assert PeerLink.describe(error) == text


@pytest.mark.parametrize(
    ("value", "kind", "expected"),
    [
        (2.6, ua.VariantType.Byte, 3),
        (1.0, ua.VariantType.Boolean, True),
        (7, ua.VariantType.Double, 7.0),
        ([1.4, 2.6], ua.VariantType.Int16, [1, 3]),
    ],
)
def test_outputs_take_the_type_of_their_node(value, kind, expected):
    made = variant(value, kind)
    assert (made.Value, made.VariantType) == (expected, kind)

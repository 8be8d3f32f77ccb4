"""Injecting, listing and ending; what is refused, and in which words."""

import json

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilserver.config.section import schema_text
from hilserver.faults.model import FORMS, Fault, parse_fault, parse_faults
from hilserver.faults.scenario import Scenario
from tests.faults.rig import Rig

BIAS = {"fault": "bias", "signal": "pose.x_m", "offset": 1.0}


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        ({"fault": "bias", "signal": "pose.x_m"}, "bias needs 'offset'"),
        ({"fault": "bias", "offset": 1}, "bias needs 'signal'"),
        ({"fault": "bias", "signal": "a", "offset": 1, "sd": 1}, "does not take 'sd'"),
        ({"fault": "bias", "peer": "a", "offset": 1}, "bias acts on signal"),
        (
            {"fault": "rust", "signal": "a"},
            "fault: 'rust' is not valid; it should be 'stuck'",
        ),
        (BIAS | {"signal": "pose.z_m"}, "there is no signal 'pose.z_m'"),
        (
            BIAS | {"signal": "pose.x"},
            "there is no signal 'pose.x'; did you mean 'pose.x_m'",
        ),
        (
            BIAS | {"signal": "internal.command"},
            "there is no signal 'internal.command'",
        ),
        (BIAS | {"signal": "sim.tick"}, "shows time or state"),
        (BIAS | {"offset": float("nan")}, "finite number"),
        (BIAS | {"offset": 1e300}, "less than or equal to"),
        (BIAS | {"colour": "red"}, "unknown key 'colour'; known are"),
        (BIAS | {"from_s": 3, "until_s": 2}, "until_s is 2, it must be above from_s"),
        (
            {"fault": "delay", "signal": "pose.x_m", "delay_s": 2},
            "reaches back at most 1.023 s",
        ),
        ({"fault": "delay", "peer": "plc", "delay_s": 2}, "there is no peer 'plc'"),
        (
            {"fault": "force", "signal": "drive.enable", "value": 0.5},
            "takes whole numbers",
        ),
        (
            {"fault": "force", "signal": "wheel.fl.setpoint_rpm", "value": 500},
            "is outside",
        ),
        ("bias", "a fault is a mapping"),
    ],
)
async def test_a_bad_fault_is_refused_with_one_sentence_and_nothing_happens(
    fault, sentence
):
    async with Rig() as rig:
        with pytest.raises(ValueError, match=sentence.replace("(", r"\(")) as refusal:
            rig.faults.inject(BIAS, fault)
        assert "\n" not in str(refusal.value)
        assert rig.faults.active() == []
        await rig.advance(2)
        assert rig.series("pose.x_m")[-1] == 0


async def test_what_waits_and_what_acts_is_listed():
    async with Rig() as rig:
        names = rig.faults.inject(BIAS | {"from_s": 0.010, "for_s": 0.010})
        assert names == ["bias:pose.x_m"]
        assert [a.is_acting for a in rig.faults.active()] == [False]
        await rig.advance(5)
        assert [a.is_acting for a in rig.faults.active()] == [False]
        await rig.advance(10)
        assert [a.is_acting for a in rig.faults.active()] == [True]
        assert rig.faults.counts() == {"injected": 1, "forced": 0}
        assert rig.faults.figures()["injected"] == {
            "count": 1,
            "names": "bias:pose.x_m",
        }
        await rig.advance(10)
        assert rig.faults.active() == []


async def test_the_same_name_replaces_and_an_unknown_one_is_refused():
    async with Rig() as rig:
        rig.faults.inject(BIAS)
        rig.faults.inject(BIAS | {"offset": 5.0})
        await rig.advance(1)
        assert rig.series("pose.x_m")[-1] == 5.0
        with pytest.raises(
            ValueError, match="no fault 'nothing'; active are bias:pose"
        ):
            rig.faults.clear("nothing")
        with pytest.raises(ValueError, match="not forced"):
            rig.faults.unforce("pose.x_m")


async def test_the_table_is_limited():
    async with Rig() as rig:
        for i in range(32):
            rig.faults.inject(BIAS | {"name": f"n{i}"})
            await rig.advance(1)
        with pytest.raises(ValueError, match="more than 32 signals"):
            rig.faults.inject(BIAS | {"name": "one too many"[:3]})
        rig.faults.clear()
        await rig.advance(1)
        late = {"fault": "delay", "signal": "pose.x_m", "delay_s": 0.1}
        for i in range(8):
            rig.faults.inject(late | {"name": f"n{i}"})
        with pytest.raises(ValueError, match="more than 8 signals"):
            rig.faults.inject(late)
        await rig.advance(1)
        assert len(rig.faults.active()) == 8


async def test_events_tell_what_was_done():
    async with Rig() as rig:
        rig.faults.inject(BIAS)
        rig.faults.clear()
        messages = [event.message for event in rig.events.recent]
        assert messages == [
            "fault injected: bias:pose.x_m (offset 1.0)",
            "all faults cleared",
        ]


def assert_faults_or_sentence(parse, given):
    """`parse` returns as many faults as it was given, or one sentence says what is wrong."""
    try:
        faults = parse()
    except ValueError as error:
        sentence = str(error)
        assert sentence
        assert "\n" not in sentence or "not JSON" in sentence
        return
    assert [type(fault) for fault in faults] == [Fault] * given
    assert all(fault.title for fault in faults)


@given(st.text(max_size=200) | st.binary(max_size=50).map(repr))
def test_any_text_is_a_fault_or_one_sentence(text):
    # only an empty list is no error
    assert_faults_or_sentence(lambda: parse_faults(text), given=0)


@given(
    st.dictionaries(
        st.sampled_from([*Fault.model_fields, "nonsense"]),
        st.none() | st.floats() | st.text(max_size=9) | st.sampled_from(list(FORMS)),
        max_size=6,
    )
)
def test_any_mapping_is_a_fault_or_one_sentence(data):
    assert_faults_or_sentence(lambda: [parse_fault(data)], given=1)


def test_the_schema_agrees_with_the_model():
    schema = json.loads(schema_text(Scenario))
    good = {"faults": [BIAS, {"fault": "shield.rpm_unsigned"}]}
    jsonschema.validate(good, schema)
    for wrong in (
        {"fault": "bias", "signal": "a"},
        BIAS | {"sd": 1},
        BIAS | {"peer": "x"},
    ):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate({"faults": [wrong]}, schema)
    assert json.dumps(schema)

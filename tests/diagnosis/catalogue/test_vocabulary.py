"""Every cause of the vocabulary has its block, unit, sentence and remedy."""

import re

import pytest

from hilserver.diagnosis.catalogue.vocabulary import CAUSES, cause_of, part_of
from hilserver.diagnosis.findings.explain import (
    experiments,
    explain,
    explain_finding,
    number,
    remedy,
    sentences,
    separating_experiment,
)
from hilserver.diagnosis.schema.findings import Finding, Parameter
from hilserver.plant.terms import TERMS

DATA = {
    "clock_offset", "clock_drift", "sign_flip", "swapped_sides", "unit_error", "held_samples",
    "interpolated_setpoint", "setpoint_as_measurement", "dropouts", "limited_channel",
    "missed_ticks",
}  # fmt: skip


def parameter(value, unit="1"):
    return Parameter(value=value, ci95=None, unit=unit)


def test_the_vocabulary_is_the_terms_and_the_faults_of_data():
    assert {c for c, cause in CAUSES.items() if cause.physical} == {
        t.cause for t in TERMS.values()
    }
    assert {c for c, cause in CAUSES.items() if not cause.physical} == DATA
    for term in TERMS.values():
        part = part_of(term.name)
        assert (part.unit, part.null, part.reference) == (
            term.unit,
            term.null,
            term.reference,
        )


def test_names_of_parts_and_signals_lead_to_their_cause():
    assert cause_of("nav_lever_arm.x").name == "nav_lever_arm"
    assert part_of("nav_lever_arm").name == "nav_lever_arm.x"
    assert part_of("unit_error.imu.gyro_z_rad_s").name == "unit_error"
    with pytest.raises(KeyError):
        part_of("nav_lever_arm.z")


@pytest.mark.parametrize("cause", CAUSES)
@pytest.mark.parametrize("sign", [1, -1])
def test_every_cause_has_a_finished_sentence_with_its_size(cause, sign):
    parts = CAUSES[cause].parts
    values = {p.name: parameter(sign * 0.37 if i == 0 else 2.0, p.unit)
              for i, p in enumerate(parts)}  # fmt: skip
    text = explain([cause], values)
    assert text.endswith(".")
    assert not text[0].islower()
    assert not re.search(r"[{}|?]", text), text
    assert remedy(cause, patched=True).endswith(".")
    assert "patch" not in remedy(cause, patched=False).lower()


def test_a_sentence_tells_the_direction():
    less = explain(["rotation_gain"], {"rotation_gain": parameter(-0.47)})
    more = explain(["rotation_gain"], {"rotation_gain": parameter(0.03)})
    assert "turns 47\u00a0% less" in less
    assert "turns 3\u00a0% more" in more


def test_a_group_names_every_member_and_the_experiment():
    group = ["icr_offset", "nav_lever_arm"]
    values = {
        "icr_offset": parameter(0.06, "m"),
        "nav_lever_arm.x": parameter(-0.06, "m"),
    }
    text = explain(group, values)
    assert "turns about a point" in text
    assert "tag" in text
    assert "tape" in separating_experiment(group)


def test_three_causes_get_the_experiment_of_all_three():
    text = separating_experiment(["wheel_radius", "nav_scale", "rotation_gain"])
    assert (
        text == experiments()[frozenset({"wheel_radius", "nav_scale", "rotation_gain"})]
    )


def test_a_pair_without_an_experiment_of_its_own_is_sent_to_plan():
    assert "hilserver plan" in separating_experiment(["backlash", "gyro_bias"])


def test_only_causes_of_the_vocabulary_have_sentences():
    assert set(sentences()) == set(CAUSES)
    for causes in experiments():
        assert causes <= set(CAUSES)


def test_a_comparison_names_both_values():
    both = {"rotation_gain.a": parameter(0.01), "rotation_gain.b": parameter(0.06)}
    assert explain(["rotation_gain"], both).startswith("The robot turns 1\u00a0% more")


def test_structure_outside_the_library_names_what_it_depends_on():
    finding = Finding(
        verdict="structure_not_in_library",
        causes=(),
        block="kinematics",
        regressors=("t_s",),
    )
    assert "t_s" in explain_finding(finding)


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [(-0.47, "1", "-0.47"), (0.0, "m", "0\u00a0m"), (12345.6, "rpm", "12346\u00a0rpm"),
     (2e-5, "s", "2·10⁻⁵\u00a0s")],
)  # fmt: skip
def test_numbers_are_made_for_reading(value, unit, text):
    assert number(value, unit).replace("\N{MINUS SIGN}", "-") == text

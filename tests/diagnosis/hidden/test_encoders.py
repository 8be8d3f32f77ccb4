"""One wheel's speed that is not the wheel's: in the loop, or in the log alone."""

from dataclasses import replace

import pytest
from hilserver_injector import Recorder, make

from benchmarks.diagnose_worker import measured
from hilserver.diagnosis.engine import diagnose
from hilserver.diagnosis.schema.findings import Verdict
from tests.diagnosis.assertions import the_cause_is_named
from tests.diagnosis.hidden.logs import assembly, judged, recipe

DURATION_S = 40.0


def test_a_speed_that_only_the_log_has_too_large_is_no_difference_of_radii():
    made = recipe("nothing drive", 51, DURATION_S)
    table = make(made)[0]
    table.columns["wheel.fl.speed_rpm"] *= 1.1
    (finding,) = diagnose(measured(table), assembly()).findings.findings
    assert (finding.verdict, finding.causes) == (Verdict.DATA_FAULT, ("unit_error",))
    factor = finding.parameters["unit_error.wheel.fl.speed_rpm"]
    assert factor.value == pytest.approx(1.1, rel=0.002)
    assert "wheel.fl.speed_rpm" in finding.explanation


@pytest.mark.long
@pytest.mark.parametrize(("wheel", "scale"), [(0, 0.05), (3, -0.05)])
def test_an_encoder_that_its_loop_believes_is_named_with_its_wheel(wheel, scale):
    causes = {"encoder_scale.a": scale, "encoder_scale.wheel": float(wheel)}
    found = judged(replace(recipe("nothing drive", 52, DURATION_S), causes=causes))
    the_cause_is_named(found.findings, "encoder_scale")
    (finding,) = found.findings.findings
    size = finding.parameters["encoder_scale.a"]
    assert size.value == pytest.approx(scale, rel=0.05)
    assert finding.parameters["encoder_scale.wheel"].value == wheel
    assert {t.name for t in found.evidence.extension} == set(causes)


@pytest.mark.parametrize(
    "cause",
    ["encoder_scale", pytest.param("wheel_radius_difference", marks=pytest.mark.long)],
)
def test_without_duty_and_setpoints_the_pose_judges_encoders_and_radii_alike(cause):
    """The truth is named, alone or with its twin; of two wheels on a side none is preferred."""
    hidden = {"encoder_scale": {"encoder_scale.a": 0.1, "encoder_scale.wheel": 2.0},
              "wheel_radius_difference": {"wheel_radius_difference": 0.02}}  # fmt: skip
    made = replace(
        recipe("nothing drive", 53, DURATION_S),
        causes=hidden[cause],
        recorder=Recorder(channels=("speed", "gyro", "nav")),
    )
    (finding,) = judged(made).findings.findings
    assert cause in finding.causes
    assert set(finding.causes) <= set(hidden)
    if cause == "encoder_scale":
        assert finding.parameters["encoder_scale.a"].value == pytest.approx(
            0.1, rel=0.2
        )
        assert finding.parameters["encoder_scale.wheel"].ci95 == (2.0, 3.0)
        assert "front right or rear right" in finding.explanation


def test_a_motor_that_another_wheel_drives_is_no_encoder_that_the_pose_disproves():
    causes = {"cross_talk.share": 0.12, "cross_talk.from": 2.0, "cross_talk.to": 3.0}
    (finding,) = judged(
        replace(recipe("nothing drive", 52, 60.0), causes=causes)
    ).findings.findings
    assert finding.verdict == Verdict.STRUCTURE_NOT_IN_LIBRARY
    assert finding.regressors[0].startswith("wheel.fr.")

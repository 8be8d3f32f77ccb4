"""What findings say, robot by robot."""

from hilserver.diagnosis.findings.explain import explain, of_two_wheels
from hilserver.diagnosis.schema.findings import Finding, Parameter, Verdict


def test_a_robot_with_two_wheels_has_a_left_encoder():
    parameters = {
        "encoder_scale.a": Parameter(value=0.1, ci95=(0.09, 0.11), unit="1"),
        "encoder_scale.wheel": Parameter(value=0.0, ci95=(0.0, 1.0), unit="1"),
    }
    text = explain(["encoder_scale"], parameters)
    assert "front left or rear left" in text
    finding = Finding(
        verdict=Verdict.NAMED,
        causes=("encoder_scale",),
        block="drive",
        explanation=text,
    )
    assert "encoder of one wheel (left) reads" in of_two_wheels(finding).explanation

"""What findings say, robot by robot."""

import pytest

from hilserver.diagnosis.findings.explain import MINUS, explain, of_two_wheels
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


EVERYWHERE = {"x_min": -1e3, "x_max": 1e3, "y_min": -1e3, "y_max": 1e3}


@pytest.mark.parametrize(
    ("edges", "where"),
    [
        ({"y_min": -1.77}, "Where y is above -1.77 m, "),
        ({"x_max": 0.25}, "Where x is below 0.25 m, "),
        (
            {"x_min": 0.5, "x_max": 2.0, "y_max": 3.0},
            "Where x is between 0.5 m and 2 m and y is below 3 m, ",
        ),
        ({}, "Everywhere, "),
    ],
)
def test_a_part_of_the_floor_has_only_the_edges_that_were_found(edges, where):
    edges = EVERYWHERE | edges
    parameters = {
        f"surface_change.{name}": Parameter(value=value, ci95=None, unit="m")
        for name, value in edges.items()
    }
    k_om = Parameter(value=-0.06, ci95=(-0.07, -0.05), unit="1")
    parameters |= {"surface_change.k_om": k_om}
    text = explain(["surface_change"], parameters)
    text = text.replace(MINUS, "-").replace("\N{NO-BREAK SPACE}", " ")
    assert text.startswith(where)
    assert "1000" not in text
    assert "k_om -0.06" in text

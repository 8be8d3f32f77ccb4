"""A body that follows its wheels late, and wheels that slip straight ahead."""

from dataclasses import replace

import pytest

from hilserver.diagnosis.schema.findings import Verdict
from tests.diagnosis.hidden.logs import judged, recipe

DURATION_S = 40.0


@pytest.fixture(scope="module")
def late():
    return judged(replace(recipe("nothing drive", 63, DURATION_S), causes={"body_lag": 0.2}))


@pytest.fixture(scope="module")
def slipping():
    return judged(replace(recipe("nothing drive", 62, DURATION_S), causes={"traction_slip": 0.1}))


def test_a_body_that_lags_is_named_with_its_time(late):
    (finding,) = late.findings.findings
    assert (finding.verdict, finding.causes) == (Verdict.NAMED, ("body_lag",))
    lag = finding.parameters["body_lag"]
    assert lag.value == pytest.approx(0.2, rel=0.05)
    assert lag.ci95[0] < 0.2 < lag.ci95[1]
    assert [t.name for t in late.evidence.extension] == ["body_lag"]


def test_slip_straight_ahead_is_reported_with_the_scale_that_looks_the_same(slipping):
    (finding,) = slipping.findings.findings
    assert finding.verdict is Verdict.NAMED_GROUP
    assert {"nav_scale", "traction_slip"} <= set(finding.causes)
    slip, scale = (finding.parameters[name] for name in ("traction_slip", "nav_scale"))
    assert slip.value == pytest.approx(0.1, rel=0.1)
    assert slip.value == -scale.value
    assert slip.ci95 == (-scale.ci95[1], -scale.ci95[0])
    assert slip.ci95[0] < 0.1 < slip.ci95[1]
    assert "tape measure" in finding.separating_experiment

"""One robot on two floors, with a gyro and no navigation: the twins of spins stay together."""

import pytest

from hilserver.bench.diagnose_worker import Staged, _findings, _logs
from hilserver.scenarios import SCENARIOS, judge


@pytest.mark.parametrize("name", ["surface_real", "surface_null"])
def test_the_floors_differ_where_they_do(name):
    logs, against = _logs(Staged(name, 10))
    findings = _findings(logs, against, 10)
    judged = judge(SCENARIOS[name].draw(10).expectation, findings)
    assert judged.right, judged.missing
    if name == "surface_real":
        (finding,) = findings.findings
        assert set(finding.causes) == {"rotation_gain", "gyro_scale", "wheel_radius"}
        before, after = (finding.parameters[f"rotation_gain.{s}"].value for s in "ab")
        assert before == pytest.approx(0.02, abs=0.06)
        assert after == pytest.approx(1.05 / 1.955 - 1.0, abs=0.06)

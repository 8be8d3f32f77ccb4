"""One robot on two floors, with a gyro and no navigation: the twins of spins stay together."""

import pytest

from benchmarks.diagnose_worker import Staged, _findings, _logs
from hilserver.scenarios import SCENARIOS
from reference.scenarios.judging import judge


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        ("surface_real", 0),
        ("surface_real", 1),
        pytest.param("surface_real", 10, marks=pytest.mark.long),
        pytest.param("surface_null", 10, marks=pytest.mark.long),
    ],
)
def test_the_floors_differ_where_they_do(name, seed):
    """At seed 0 all runs restart the clock; at seed 1 the runs on one floor hardly scatter.

    In every run `groups/test_floors.py` asks whether equal floors are found equal.
    """
    logs, against = _logs(Staged(name, seed))
    findings = _findings(logs, against)
    judged = judge(SCENARIOS[name].draw(seed).expectation, findings)
    assert judged.right, judged.missing
    if name == "surface_real":
        (finding,) = findings.findings
        twins = {"rotation_gain", "gyro_scale", "wheel_radius"}
        # On the spot one wheel's encoder stretches the turn as well.
        assert twins <= set(finding.causes) <= {*twins, "encoder_scale"}
        before, after = (finding.parameters[f"rotation_gain.{s}"].value for s in "ab")
        assert before == pytest.approx(0.02, abs=0.06)
        assert after == pytest.approx(1.05 / 1.955 - 1.0, abs=0.06)

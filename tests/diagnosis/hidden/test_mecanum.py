"""Mecanum robots: what moves them to the side is judged, and named."""

import pytest
from hilserver_injector import Recipe, make

from benchmarks.diagnose_worker import measured
from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.diagnosis.engine import diagnose
from hilserver.diagnosis.schema.findings import Verdict

MACHINE = assemble_config(Config.model_validate({"plant": {"drive": "mecanum"}}))


def found(causes, seed, duration_s):
    how = {"drive": "mecanum", "manoeuvre": "omni", "duration_s": duration_s}
    made = Recipe(causes=causes, seed=seed, **how)
    return diagnose(measured(make(made)[0]), MACHINE, jobs=1).findings


def test_what_has_no_meaning_for_them_is_not_judged():
    findings = found({}, 62, 60.0)
    assert findings.findings == ()
    reasons = {row.cause: row.reason for row in findings.not_judged}
    assert (
        reasons["icr_offset"]
        == reasons["side_slip"]
        == "has no meaning for mecanum wheels"
    )


@pytest.mark.long
def test_radius_rollers_and_lever_arm_are_named_together():
    hidden = {"wheel_radius": 0.04, "roller_slip": 0.1, "nav_lever_arm.x": 0.1}
    findings = found(hidden, 64, 360.0)
    said = {cause: finding for finding in findings.findings for cause in finding.causes}
    for name, size in hidden.items():
        finding = said[name.partition(".")[0]]
        assert finding.verdict in (Verdict.NAMED, Verdict.NAMED_GROUP)
        assert finding.parameters[name].value == pytest.approx(size, rel=0.2)
    assert said["nav_lever_arm"].causes == ("nav_lever_arm",)

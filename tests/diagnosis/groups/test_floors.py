"""One machine on two floors: what is the machine's and what the floor's comes out apart."""

from dataclasses import replace
from functools import cache

import pytest
from hilserver_injector import Recorder, make

from benchmarks.diagnose_worker import measured
from hilserver.config.patch import load_patch
from hilserver.diagnosis.engine import diagnose_groups
from hilserver.diagnosis.findings.patch import as_yaml, make_patch
from hilserver.diagnosis.output import documents
from hilserver.diagnosis.report.summary import summary
from tests.diagnosis.assertions import said
from tests.diagnosis.hidden.logs import assembly, recipe

POSE = Recorder(channels=("speed", "nav"))
"""Without set-points and duty there is no drive to judge, which takes most of the time."""
MACHINE = {"wheel_radius_difference": 0.02}
FLOORS = {"asphalt": {"rotation_gain": -0.05}, "sand": {"rotation_gain": -0.2}}


@cache
def diagnosed(*, differ: bool):
    """Two minutes of one machine on two floors, or twice on the same one."""
    logs = {}
    for number, (name, floor) in enumerate(FLOORS.items()):
        causes = MACHINE | (floor if differ else FLOORS["sand"])
        made = replace(
            recipe("nothing drive", 31 + number, 40.0), causes=causes, recorder=POSE
        )
        logs[name] = measured(make(made)[0])
    return diagnose_groups(logs, assembly(), jobs=1)


def fitted(found):
    """Findings by their first cause; speeds alone do not tell wheels from encoders."""
    return {f.causes[0] if f.causes else "": f for f in found.findings.findings}


def test_on_equal_floors_all_is_shared():
    found = diagnosed(differ=False)
    assert set(fitted(found)) == {"rotation_gain", "wheel_radius_difference"}, said(
        found.findings
    )
    for name, truth in (FLOORS["sand"] | MACHINE).items():
        parameter = fitted(found)[name].parameters[name]
        assert parameter.groups is None
        assert parameter.ci95[0] <= truth <= parameter.ci95[1]
    assert make_patch(found, "0").groups is None


def test_what_differs_by_floor_is_free_and_what_does_not_is_shared():
    found = diagnosed(differ=True)
    assert set(fitted(found)) == {"rotation_gain", "wheel_radius_difference"}, said(
        found.findings
    )
    shared = fitted(found)["wheel_radius_difference"].parameters[
        "wheel_radius_difference"
    ]
    free = fitted(found)["rotation_gain"].parameters["rotation_gain"]
    assert shared.groups is None
    assert shared.ci95[0] <= 0.02 <= shared.ci95[1]
    assert free.ci95 is None, "there is no pooled interval"
    for name, floor in FLOORS.items():
        low, high = free.groups[name].ci95
        assert low <= floor["rotation_gain"] <= high
        assert found.findings.groups[name].total_gain["yaw_rad"].ratio > 1.5
    assert found.findings.total_gain["yaw_rad"].ci95[0] > 1.5
    assert set(found.findings.joint.parameters) == {
        "rotation_gain@asphalt", "rotation_gain@sand", "wheel_radius_difference",
    }  # fmt: skip


def test_report_and_terminal_say_what_belongs_to_what():
    found = diagnosed(differ=True)
    files = documents(found)
    told = " ".join(summary(found.findings).split())
    assert "belongs to the machine: wheel_radius_difference" in told
    assert "belongs to the floor or the load: rotation_gain (asphalt" in told
    assert "What belongs to the machine" in files["report.html"]
    assert "--group NAME" in files["report.html"]
    alike = documents(diagnosed(differ=False))["report.html"]
    assert "--group NAME" not in alike


@pytest.mark.parametrize(("group", "gain"), [("asphalt", -0.05), ("sand", -0.2)])
def test_the_patch_holds_both_floors(tmp_path, group, gain):
    path = tmp_path / "model_patch.yaml"
    path.write_text(as_yaml(make_patch(diagnosed(differ=True), "0")), encoding="utf-8")
    terms = load_patch(path, group).model.terms
    assert set(terms) == {"rotation_gain", "wheel_radius_difference"}
    assert terms["rotation_gain"].value == pytest.approx(gain, abs=0.02)

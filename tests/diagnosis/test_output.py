"""The files of a diagnosis: whole, consistent, and a patch that the daemon takes."""

import hashlib
import json
from dataclasses import replace

import pytest
import yaml

from hilserver.config.patch import FittedIn, load_patch
from hilserver.diagnosis.checks.standstill import too_little_motion
from hilserver.diagnosis.output import documents, findings_text, write
from hilserver.diagnosis.report.summary import one_line, summary
from hilserver.diagnosis.schema.evidence import Diagnosis, Evidence, FittedTerm
from hilserver.diagnosis.schema.findings import Findings, Overall, Parameter, overall
from hilserver.errors import FailedError
from tests.diagnosis.sample import ROTATION, evidence, findings, nothing_found

FITTED = Evidence(
    extension=(FittedTerm("rotation_gain", ROTATION),),
    fitted=FittedIn(
        speed_m_s=(0.0, 0.4), turn_rate_rad_s=(-1.0, 1.0), conditions="carpet"
    ),
)


def test_the_patch_can_be_loaded_and_names_the_findings(tmp_path):
    write(tmp_path, documents(Diagnosis(findings(), FITTED)))
    patch = load_patch(tmp_path / "model_patch.yaml").model
    found = (tmp_path / "findings.json").read_bytes()
    assert patch.made_from.findings_sha256 == hashlib.sha256(found).hexdigest()
    assert patch.made_from.config_sha256 == findings().config_sha256
    term = patch.terms["rotation_gain"]
    assert (term.value, term.ci95, term.unit) == (-0.47, (-0.48, -0.46), "1")
    assert term.fitted_in.speed_m_s == (0.0, 0.4)
    assert term.fitted_in.conditions == "hall <3>.csv: carpet"
    assert term.fitted_in.wheel_speed_rpm is None


def test_a_patch_has_no_key_of_the_second_schema():
    text = documents(Diagnosis(findings(), FITTED))["model_patch.yaml"]
    assert set(yaml.safe_load(text)) == {"schema", "made_from", "terms"}


def test_the_findings_come_back_as_they_were(tmp_path):
    write(tmp_path, documents(Diagnosis(findings(), evidence(500))))
    data = json.loads((tmp_path / "findings.json").read_text(encoding="utf-8"))
    assert data["schema"] == "hilserver.diagnosis/2"
    read = Findings.model_validate(data)
    assert findings_text(read) == (tmp_path / "findings.json").read_text(
        encoding="utf-8"
    )
    for key, gain in findings().total_gain.items():
        assert read.total_gain[key].ratio == pytest.approx(gain.ratio, rel=1e-8), (
            "nine digits"
        )
    plain = {
        "total_gain": {},
        "patch_gain": {},
        "findings": (),
        "smallest_detectable": (),
    }
    assert read.model_copy(update=plain) == findings().model_copy(update=plain)
    assert [f.parameters for f in read.findings] == [
        f.parameters for f in findings().findings
    ]


def test_without_an_extension_there_is_no_patch_and_an_old_one_goes(tmp_path):
    write(tmp_path, documents(Diagnosis(findings(), FITTED)))
    write(tmp_path, documents(Diagnosis(nothing_found())))
    assert {p.name for p in tmp_path.iterdir()} == {"findings.json", "report.html"}
    assert json.loads((tmp_path / "findings.json").read_text())["model_patch"] is None


def test_older_files_for_other_programs_go_and_those_of_the_user_stay(tmp_path):
    older = ("for/config.yaml", "for/urdf/wheels.urdf", "for/sand/parameters.csv")
    for name in (*older, "for/notes.txt", "for/sand/my.urdf", "for/sdf/wheels.sdf"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("older")
    write(tmp_path, {"findings.json": "", "for/sdf/wheels.sdf": "newer"})
    left = {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*") if p.is_file()}
    assert left == {
        "findings.json", "for/notes.txt", "for/sand/my.urdf", "for/sdf/wheels.sdf"
    }  # fmt: skip
    assert (tmp_path / "for/sdf/wheels.sdf").read_text() == "newer"


def test_findings_stand_last_so_that_they_mean_all_is_there():
    assert list(documents(Diagnosis(findings(), FITTED)))[-1] == "findings.json"


def test_what_cannot_be_written_is_a_sentence_and_leaves_no_half_file(tmp_path):
    (tmp_path / "report.html").mkdir()
    with pytest.raises(FailedError, match="is a directory"):
        write(tmp_path, documents(Diagnosis(findings(), FITTED)))
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


def test_the_summary_is_made_of_words():
    text = summary(findings())
    assert text.startswith("Three things differ from the simulation")
    assert "The robot turns 47\u00a0% less" in text
    assert "tell them apart" in text
    assert "7.8 times smaller, 95 % 6.1 to 9" in " ".join(text.split())
    assert max(map(len, text.splitlines())) <= 96


def test_one_line_per_log():
    assert one_line(nothing_found()) == "nothing_found"
    told = one_line(findings())
    assert told == (
        "findings: rotation_gain, icr_offset or nav_lever_arm, structure_not_in_library, unit_error"
    )


def test_too_little_motion_is_not_nothing_found_in_any_output():
    still = nothing_found().model_copy(update={"findings": (too_little_motion(),)})
    assert one_line(still) == "insufficient_excitation"
    assert summary(still).startswith("The robot stood still")
    page = documents(Diagnosis(still, evidence(300)))["report.html"]
    assert "nothing was found" not in page
    assert "is sensor noise" not in page


def test_what_could_not_be_judged_is_not_nothing_found():
    assert overall(()) == Overall.NOTHING_FOUND
    assert overall((), is_judged=False) == Overall.NOT_JUDGED
    named, fault = findings().findings[0], findings().findings[3]
    assert overall((fault,), is_judged=False) == Overall.NOT_JUDGED
    assert overall((fault,)) == Overall.FINDINGS
    assert overall((fault, named), is_judged=False) == Overall.FINDINGS


@pytest.mark.parametrize("verdict", ["nothing_found", "no_difference", "not_judged"])
def test_where_nothing_could_be_judged_the_simulation_is_not_said_to_fit(verdict):
    found = nothing_found().model_copy(
        update={"verdict": verdict, "smallest_detectable": ()}
    )
    assert found.not_judged
    assert summary(found).startswith(
        "Nothing about the robot could be judged (no duty)."
    )


def test_a_term_of_several_parts_keeps_them_all():
    terms = (
        FittedTerm("stribeck_friction.f_s", Parameter(value=4.0, ci95=None, unit="%")),
        FittedTerm(
            "stribeck_friction.n_s", Parameter(value=6.0, ci95=None, unit="rpm")
        ),
    )
    text = documents(Diagnosis(findings(), replace(FITTED, extension=terms)))[
        "model_patch.yaml"
    ]
    assert "stribeck_friction.f_s" in text
    assert "stribeck_friction.n_s" in text

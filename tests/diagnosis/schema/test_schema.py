"""Schemas and reference say what the code says; the example of the specification fits."""

import json
from pathlib import Path

import jsonschema
import pytest
import yaml

from hilserver.config.patch import ModelPatch
from hilserver.config.section import schema_text
from hilserver.diagnosis.output import documents, findings_text
from hilserver.diagnosis.schema.evidence import Diagnosis
from hilserver.diagnosis.schema.findings import Findings
from tests.diagnosis.sample import evidence, findings, nothing_found

ROOT = Path(__file__).parents[3]
FINDINGS, PATCH = (json.loads(schema_text(model)) for model in (Findings, ModelPatch))
EXAMPLE = json.loads("""
{"schema": "hilserver.diagnosis/2", "verdict": "findings",
 "logs": [{"file": "run1.csv", "sha256": "..."}], "seed": 0, "version": "...",
 "config_sha256": "...",
 "baseline": {"position_m": 0.31, "yaw_rad": 0.12, "speed_rpm": 1.4, "duty_pct": 2.0,
  "gyro_z_rad_s": 0.02},
 "findings": [{"verdict": "named", "causes": ["rotation_gain"], "block": "kinematics",
   "parameters": {"rotation_gain": {"value": -0.47, "ci95": [-0.48, -0.46], "unit": "1"}},
   "p_adjusted": 0.001, "explanation": "one sentence a technician understands",
   "separating_experiment": null, "regressors": [],
   "gain": {"yaw_rad": {"horizon_s": 5.0, "before": 0.31, "after": 0.04, "ratio": 7.7,
    "ci95": [6.1, 9.0]}}}],
 "total_gain": {"position_m": {"horizon_s": 5.0, "before": 0.31, "after": 0.1, "ratio": 3.1,
  "ci95": [2.7, 3.6]}},
 "ceiling": {"position_m": 3.9},
 "smallest_detectable": [{"cause": "rotation_gain", "size": 0.008, "unit": "1"}],
 "not_judged": [{"cause": "dead_zone", "reason": "no duty in the log"}],
 "model_patch": "model_patch.yaml"}
""")


@pytest.mark.parametrize(
    ("name", "made"), [("findings", FINDINGS), ("model_patch", PATCH)]
)
def test_the_shipped_schemas_are_up_to_date(name, made):
    shipped = ROOT / "hilserver" / "diagnosis" / "schema" / f"{name}.schema.json"
    assert json.loads(shipped.read_text(encoding="utf-8")) == made, (
        "run: make reference"
    )
    jsonschema.Draft202012Validator.check_schema(made)


def test_the_example_of_the_specification_fits_schema_and_model():
    jsonschema.validate(EXAMPLE, FINDINGS)
    assert (
        json.loads(findings_text(Findings.model_validate(EXAMPLE))).items()
        >= EXAMPLE.items()
    )


@pytest.mark.parametrize("found", [findings(), nothing_found()])
def test_what_is_written_fits_its_schema(found):
    files = documents(Diagnosis(found, evidence(300)))
    jsonschema.validate(json.loads(files["findings.json"]), FINDINGS)
    jsonschema.validate(yaml.safe_load(files["model_patch.yaml"]), PATCH)


@pytest.mark.parametrize(
    "change",
    [
        {"verdict": "perhaps"},
        {"schema": "hilserver.diagnosis/1"},
        {"more": 1},
        {"seed": "none"},
    ],
)
def test_the_schema_refuses_what_is_wrong(change):
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(EXAMPLE | change, FINDINGS)

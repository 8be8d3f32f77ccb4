"""The schema and the shipped file say what the code says."""

import json
from pathlib import Path

import jsonschema
import pytest
import yaml

from hilserver.config.root import Config, load_config
from hilserver.config.section import schema_text

ROOT = Path(__file__).parents[2]
SCHEMA = json.loads(schema_text(Config))


def test_the_schema_is_up_to_date():
    assert json.loads((ROOT / "config.schema.json").read_text()) == SCHEMA, (
        "run: make reference"
    )


def test_the_shipped_file_is_the_default_and_names_every_key():
    assert load_config(ROOT / "config.yaml") == Config()
    shipped = yaml.safe_load((ROOT / "config.yaml").read_text(encoding="utf-8"))

    def keys(value, prefix=""):
        if isinstance(value, dict):
            for key, inner in value.items():
                yield prefix + key
                yield from keys(inner, f"{prefix}{key}.")

    defaults = set(keys(Config().model_dump(mode="json")))
    assert set(keys(shipped)) == defaults


def test_the_schema_accepts_the_shipped_file_and_refuses_a_wrong_key():
    shipped = yaml.safe_load((ROOT / "config.yaml").read_text(encoding="utf-8"))
    jsonschema.validate(shipped, SCHEMA)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({"plant": {"max_rmp": 1}}, SCHEMA)

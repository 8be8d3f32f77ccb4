"""JSON Schemas of findings.json and model_patch.yaml.

``python -m reference.schemas findings`` (or ``patch``) prints one.
"""

import json
import sys
from typing import Any

from hilserver.config import patch
from hilserver.diagnosis.schema.findings import Findings


def findings_schema() -> dict[str, Any]:
    """Return the JSON Schema of findings.json."""
    schema = Findings.model_json_schema(by_alias=True, mode="validation")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


SCHEMAS = {"findings": findings_schema, "patch": patch.json_schema}

if __name__ == "__main__":
    print(json.dumps(SCHEMAS[sys.argv[1]](), indent=1))

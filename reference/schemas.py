"""JSON Schemas of findings.json and model_patch.yaml.

``python -m reference.schemas findings`` (or ``patch``) prints one.
"""

import sys

from pydantic import BaseModel

from hilserver.config.patch import ModelPatch
from hilserver.config.section import schema_text
from hilserver.diagnosis.schema.findings import Findings

SCHEMAS: dict[str, type[BaseModel]] = {"findings": Findings, "patch": ModelPatch}

if __name__ == "__main__":
    print(schema_text(SCHEMAS[sys.argv[1]]), end="")

"""Changes of the parameters as text: the sparse channel `/hilserver/parameters` of a recording.

Besides the values by name, for people and plots, it holds the packed numbers that the plant
continued with: a replay uses these and recomputes none of them.
"""

import base64
import json
from collections.abc import Mapping
from math import isfinite
from typing import Any, Final

import numpy as np

from hilserver.logs.log import Change

TOPIC: Final = "/hilserver/parameters"
_NUMBER: Final = {"type": "integer"}
SCHEMA: Final[Mapping[str, Any]] = {
    "title": "hilserver.Parameters",
    "type": "object",
    "properties": {
        "segment": _NUMBER,
        "tick": {**_NUMBER, "description": "the first tick with these values"},
        "number": {**_NUMBER, "description": "internal.edition from this tick on"},
        "parameters": {
            "type": "object",
            "description": "every value by name; null as in config.yaml",
            "additionalProperties": {"type": ["number", "null"]},
        },
        "packed": {
            "type": "string",
            "description": "float64, little-endian, in base64",
        },
    },
}
"""JSON Schema of a message."""


def as_text(change: Change) -> str:
    """Return a change as one line of JSON."""
    values = {name: v if isfinite(v) else None for name, v in change.values.items()}
    packed = base64.b64encode(change.packed.astype("<f8").tobytes()).decode()
    own = {"segment": change.segment, "tick": change.tick, "number": change.number}
    return json.dumps(
        {**own, "parameters": values, "packed": packed}, separators=(",", ":")
    )


def from_text(text: str | bytes) -> Change:
    """Return the change in a line; ValueError, KeyError or TypeError if it is not one."""
    data = json.loads(text)
    packed = np.frombuffer(base64.b64decode(data["packed"], validate=True), dtype="<f8")
    values = {
        str(name): np.nan if value is None else float(value)
        for name, value in data["parameters"].items()
    }
    segment, tick, number = (int(data[key]) for key in ("segment", "tick", "number"))
    return Change(segment, tick, number, values, packed.astype(np.float64))

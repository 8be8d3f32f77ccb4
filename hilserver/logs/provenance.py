"""Where a recording comes from: version, configuration, kernels, seed, audit.

The configuration is kept as YAML text, as it was after validation, without secrets.
"""

import base64
import json
import re
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import yaml

from hilserver.logs.log import State

SCHEMA = "hilserver.recording/1"
_SECRET = re.compile(r"password|secret|token|passphrase|hash$", re.IGNORECASE)


def make_run(description: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a recording says about its run, from the description of the process image."""
    run = dict(description["run"])
    configuration = run.pop("configuration", None)
    return {
        "schema": SCHEMA,
        **run,
        "configuration": None if configuration is None else as_yaml(configuration),
        "signals": [s for s in description["signals"] if len(s["slots"]) == 1],
        "layout": description["regions"],
    }


def as_yaml(configuration: Mapping[str, Any]) -> str:
    """Return a configuration as YAML text, secrets blotted out."""
    return yaml.safe_dump(_without_secrets(configuration), sort_keys=False, allow_unicode=True)


def _without_secrets(node: Any) -> Any:
    if isinstance(node, Mapping):
        return {
            key: "***" if isinstance(value, str) and _SECRET.search(str(key)) else
            _without_secrets(value)
            for key, value in node.items()
        }  # fmt: skip
    if isinstance(node, list | tuple):
        return [_without_secrets(value) for value in node]
    return node


def pack_meta(run: Mapping[str, Any], states: Sequence[State]) -> str:
    """Return run and states as JSON, for formats that have no room for them."""
    entries = [
        {"segment": s.segment, "tick": s.tick, "zlib_base64": _pack_words(s)} for s in states
    ]
    return json.dumps({**run, "states": entries}, indent=1)


def unpack_meta(text: str) -> tuple[dict[str, Any], list[State]]:
    """Return run and states from what `pack_meta` wrote.

    ValueError if the text is damaged or of another schema.
    """
    try:
        run: dict[str, Any] = json.loads(text)
        if run["schema"] != SCHEMA:
            raise ValueError(f"is not of schema {SCHEMA}")
        states = [_unpack_state(entry) for entry in run.pop("states")]
        _ = [signal["name"] for signal in run["signals"]], int(run["base_period_ns"])
    except (KeyError, TypeError, AttributeError, zlib.error) as error:
        raise ValueError(f"is damaged: {error}") from None
    return run, states


def _pack_words(state: State) -> str:
    return base64.b64encode(zlib.compress(state.words.astype("<i8").tobytes())).decode()


def _unpack_state(entry: Mapping[str, Any]) -> State:
    data = zlib.decompress(base64.b64decode(entry["zlib_base64"], validate=True))
    words = np.frombuffer(data, dtype="<i8").astype(np.int64)
    return State(int(entry["segment"]), int(entry["tick"]), words)

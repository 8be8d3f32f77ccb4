"""Where a recording comes from: version, configuration, kernels, seed, audit.

The configuration is kept as YAML text, as it was after validation, without secrets.
"""

import re
from collections.abc import Mapping
from typing import Any

import yaml

SCHEMA = "hilserver.recording/1"
_SECRET = re.compile(r"password|secret|token|passphrase|hash$", re.IGNORECASE)


def make_run(description: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a recording says about its run.

    Parameters
    ----------
    description : mapping
        Of the process image: signals, regions and ``run``.
    """
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

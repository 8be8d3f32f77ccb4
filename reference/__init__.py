"""The pages of ``docs/reference`` that are made from the code; no part of the installed package.

``python -m reference`` writes all of them; a test compares.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from hilserver.commands import signals
from hilserver.daemon.assembly import assemble
from reference import (
    configuration,
    control,
    faults,
    findings,
    mapping,
    metrics,
    parameters,
    states,
    step,
)

FOLDER: Final = Path(__file__).parents[1] / "docs" / "reference"
PAGES: Final[Mapping[str, Callable[[], str]]] = {
    "configuration.md": configuration.as_markdown,
    "control.md": control.as_markdown,
    "faults.md": faults.as_markdown,
    "findings.md": findings.as_markdown,
    "mapping.md": mapping.as_markdown,
    "metrics.md": metrics.as_markdown,
    "parameters.md": parameters.as_markdown,
    "signals.md": lambda: signals.as_markdown(assemble(None).table),
    "states.md": states.as_markdown,
    "step.md": step.as_markdown,
}

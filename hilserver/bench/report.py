"""The form in which every measured figure is printed and written: schema ``hilserver.bench/1``."""

import json
import os
import platform
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hilserver import __version__

SCHEMA = "hilserver.bench/1"


@dataclass(frozen=True)
class Result:
    """One figure with its reference from the same run."""

    name: str
    value: float
    unit: str
    reference: float | None = None  # the same figure of the reference program, in the same unit
    reference_name: str | None = None
    ratio: float | None = None
    raw: Any = None  # histograms, blocks, command lines: whatever the figure was made from


def machine() -> dict[str, Any]:
    """Describe the machine well enough to read a figure, without names that identify it."""
    model = platform.processor() or "unknown"
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith("model name"):
            model = line.split(":", 1)[1].strip()
            break
    return {
        "cpu": model,
        "cores": os.cpu_count(),
        "kernel": platform.release(),
        "python": platform.python_version(),
        "hilserver": __version__,
    }


def write_json(path: Path, results: Iterable[Result]) -> None:
    """Write the results with the machine they were measured on."""
    document = {
        "schema": SCHEMA,
        "machine": machine(),
        "results": [asdict(result) for result in results],
    }
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def as_table(results: Iterable[Result]) -> str:
    """Return the results as lines of a table for the terminal."""
    lines = [f"{'figure':34} {'value':>12} {'unit':6} {'reference':>12} {'ratio':>7}  reference is"]
    for r in results:
        reference = "" if r.reference is None else f"{r.reference:.4g}"
        ratio = "" if r.ratio is None else f"{r.ratio:.2f}"
        name = r.reference_name or ""
        lines.append(
            f"{r.name:34} {r.value:12.4g} {r.unit:6} {reference:>12} {ratio:>7}  {name}".rstrip()
        )
    return "\n".join(lines)

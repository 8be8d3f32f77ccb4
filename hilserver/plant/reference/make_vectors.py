"""Maintenance: ``python -m hilserver.plant.reference.make_vectors`` writes the vectors anew.

To be run after a deliberate change of the recurrence, and only when the C reference agrees with it.
"""

import sys
from pathlib import Path

from hilserver.plant.reference.vectors import cases, inputs_csv, to_csv


def main() -> int:
    """Write all files beside this one; return 0."""
    folder = Path(__file__).parent / "vectors"
    folder.mkdir(exist_ok=True)
    (folder / "inputs.csv").write_text(inputs_csv(), encoding="utf-8")
    for name, terms in cases().items():
        (folder / f"{name}.csv").write_text(to_csv(terms), encoding="utf-8")
    sys.stdout.write(f"{len(cases()) + 1} files in {folder}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

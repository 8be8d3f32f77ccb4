"""The log as its reader gets it, and the sealed truth beside it."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilserver_injector.recipe import Recipe

Array = NDArray[np.float64]


@dataclass
class Table:
    """Columns by signal name; NaN is no sample.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
        Stamps.
    columns : dict of str to ndarray, shape (n,)
    """

    t_s: Array
    columns: dict[str, Array]

    def write_csv(self, path: Path) -> None:
        """Write the table as the log contract has it: empty is no sample."""
        names = list(self.columns)
        block = np.stack([self.columns[name] for name in names], axis=1)
        with path.open("w", encoding="utf-8") as file:
            file.write(",".join(["t_s", *names]) + "\n")
            for t, row in zip(self.t_s.tolist(), block.tolist(), strict=True):
                cells = ["" if value != value else f"{value:.7g}" for value in row]
                file.write(f"{t:.6f},{','.join(cells)}\n")


@dataclass
class Truth:
    """What is hidden in a log: opened only after the verdict.

    Attributes
    ----------
    dense : ndarray, shape (m, 8)
        t, x, y, yaw, v, vy, om, left wheel angle, every millisecond.
    """

    recipe: Recipe
    dense: Array
    notes: dict[str, Any]

    def write_json(self, path: Path) -> None:
        """Write recipe and notes."""
        document = {"recipe": asdict(self.recipe), **self.notes}
        path.write_text(
            json.dumps(document, indent=1, default=str) + "\n", encoding="utf-8"
        )

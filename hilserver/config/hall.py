"""A hall from a file: the walls that the range finders see, as YAML."""

from pathlib import Path
from typing import Final

import numpy as np
import yaml
from numpy.typing import NDArray

from hilserver.plant.errors import PlantError
from hilserver.plant.hall import default_hall

MOST_WALLS: Final = 4096


def load_hall(hall: str, base_dir: Path) -> NDArray[np.float64]:
    """Return the walls of a hall, shape (4 n,): x1, y1, x2, y2 [m] of each.

    Parameters
    ----------
    hall : str
        ``default`` or the path of a YAML file, relative to `base_dir`.
    base_dir : Path
        The directory of the configuration file.

    Raises
    ------
    PlantError
        When the file is missing or is no list of finite segments.
    """
    if hall == "default":
        return default_hall()
    path = base_dir / hall
    where = f"sensors.tof.hall: {path}"
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        reason = str(error).splitlines()[0]
        msg = f"{where} cannot be read: {reason}."
        raise PlantError(msg) from error
    walls = content.get("walls") if isinstance(content, dict) else None
    if not isinstance(walls, list) or len(walls) > MOST_WALLS:
        msg = f"{where} must have a list `walls` of at most {MOST_WALLS} segments."
        raise PlantError(msg)
    for number, wall in enumerate(walls, start=1):
        numbers = isinstance(wall, list) and len(wall) == 4
        if not numbers or not all(
            isinstance(v, int | float) and not isinstance(v, bool) and np.isfinite(v) for v in wall
        ):
            msg = f"{where}: wall {number} must be four finite numbers [x1, y1, x2, y2] in m."
            raise PlantError(msg)
    return np.array(walls, dtype=np.float64).reshape(-1)

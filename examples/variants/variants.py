"""A campaign: one drive with many robots, as fast as the computer allows, and one line for each.

Every variant is a configuration; `hilserver simulate` plays the same scenario with it in virtual
time. The summary is a table for a spreadsheet; the recordings stay beside it for a closer look.
"""

import csv
import itertools
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import yaml

from hilserver.logs import read_log

SCENARIO = Path(__file__).parent / "drive.yaml"
VARIED = {  # key of the plant, and its values: every combination is a variant
    "terms.rotation_gain": (0.0, -0.2, -0.4),
    "controller.k_i": (100.0, 195.84),
}
JOBS = 2


def configuration(values: dict[str, float]) -> dict[str, object]:
    """Return the configuration of a variant."""
    plant: dict[str, object] = {}
    for key, value in values.items():
        *sections, last = key.split(".")
        place = plant
        for section in sections:
            place = place.setdefault(section, {})  # type: ignore[assignment]
        place[last] = value
    return {"plant": plant}


def simulated(out: Path, name: str, values: dict[str, float]) -> dict[str, object]:
    """Play one variant; return its line of the summary."""
    config, log = out / f"{name}.yaml", out / f"{name}.csv"
    config.write_text(yaml.safe_dump(configuration(values)))
    command = [sys.executable, "-m", "hilserver", "simulate", str(SCENARIO)]
    command += ["-c", str(config), "-o", str(log)]
    subprocess.run(command, check=True, capture_output=True)  # noqa: S603 -- our own words
    columns = read_log(log).columns
    late_m_s = columns["velocity.linear_m_s"] - columns["twist.linear_m_s"]
    return {
        "variant": name,
        **values,
        "x_m": round(float(columns["pose.x_m"][-1]), 4),
        "y_m": round(float(columns["pose.y_m"][-1]), 4),
        "yaw_rad": round(float(columns["pose.yaw_rad"][-1]), 4),
        "largest_duty_pct": round(float(np.abs(columns["wheel.fl.duty_pct"]).max()), 2),
        "speed_error_m_s": round(float(np.abs(late_m_s).mean()), 5),
    }


def main(out: Path) -> None:
    """Play all variants and write summary.csv."""
    out.mkdir(parents=True, exist_ok=True)
    variants = [
        dict(zip(VARIED, values, strict=True))
        for values in itertools.product(*VARIED.values())
    ]
    with ThreadPoolExecutor(JOBS) as pool:
        names = [f"variant_{number:03d}" for number in range(len(variants))]
        lines = list(
            pool.map(
                lambda one: simulated(out, *one), zip(names, variants, strict=True)
            )
        )
    with (out / "summary.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, lines[0])
        table.writeheader()
        table.writerows(lines)
    print(f"{len(lines)} variants: {out / 'summary.csv'}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "campaign"))

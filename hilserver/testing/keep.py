"""What is kept of a failed test: recording, scenario, configuration, seed."""

import csv
import json
import re
from pathlib import Path

import yaml

from hilserver import __version__
from hilserver.compiled import kernel_hash
from hilserver.faults.scenario import as_yaml
from hilserver.testing.hil import Hil


def keep(hil: Hil, folder: Path, test: str) -> Path:
    """Write everything that plays the failure again below `folder`; return where.

    Parameters
    ----------
    test : str
        The test's node id.
    """
    place = folder / re.sub(r"[^A-Za-z0-9_.-]+", "_", test)[-120:]
    place.mkdir(parents=True, exist_ok=True)
    hil.tap.drain()
    config = hil.daemon.config
    seed = config.plant.seed
    write_recording(hil, place)
    scenario = hil.journal.scenario(f"{test} failed", seed)
    (place / "scenario.yaml").write_text(as_yaml(scenario), encoding="utf-8")
    text = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)
    (place / "config.yaml").write_text(text, encoding="utf-8")
    run = {
        "test": test,
        "mode": hil.mode,
        "seed": seed,
        "tick": hil.tick,
        "frames_lost": hil.tap.lost,
        "version": __version__,
        "kernel": kernel_hash(),
        "configuration": config.sha256,
    }
    (place / "run.json").write_text(json.dumps(run, indent=1) + "\n", encoding="utf-8")
    return place


def write_recording(hil: Hil, place: Path) -> None:
    """Write the newest frames as ``recording.csv``, all signals with their names."""
    signals = [signal for signal in hil.daemon.table if not signal.is_array]
    slots = [signal.slots[0] for signal in signals]
    with (place / "recording.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["tick", *(signal.name for signal in signals)])
        for tick, values in hil.tap.kept:
            writer.writerow([tick, *(f"{value:.9g}" for value in values[slots])])

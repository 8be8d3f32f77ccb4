"""Files kept of a failed test: recording, scenario, configuration, seed."""

import json
import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import yaml

from hilserver import __version__
from hilserver.compiled import kernel_hash
from hilserver.faults.scenario import as_yaml
from hilserver.image import Frame, to_batch
from hilserver.logs import Segmented, open_writer
from hilserver.logs.provenance import make_run
from hilserver.testing.hil import Hil


def keep(hil: Hil, folder: Path, test: str) -> Path:
    """Write everything that repeats the failure below `folder`; return the place."""
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
    """Write the newest frames, all signals, as ``recording.mcap``."""
    run = make_run(hil.daemon.image.description)
    frames = list(hil.tap.kept)
    planned_ns = frames[-1].planned_ns if frames else 0
    utc_minus_planned_ns = hil.daemon.clock.utc_ns(planned_ns) - planned_ns
    slots = range(len(run["signals"]))
    writer = open_writer(place / "recording.mcap", run, slots, utc_minus_planned_ns)
    for batch in _segmented(frames):
        writer.write(batch)
    writer.close()


def _segmented(frames: Sequence[Frame]) -> Iterator[Segmented]:
    """Begin a new batch after missing frames, and a new segment after a reset of the simulation."""
    numbers, ticks = (
        np.array([getattr(frame, name) for frame in frames], dtype=np.int64)
        for name in ("number", "tick")
    )
    follows = np.diff(numbers) == 1
    segments = np.concatenate([[0], np.cumsum(follows & (np.diff(ticks) != 1))])
    cuts = [0, *(np.flatnonzero(~follows) + 1), len(frames)]
    for begin, end in pairwise(cuts):
        if end > begin:
            yield Segmented(to_batch(frames[begin:end]), segments[begin:end])

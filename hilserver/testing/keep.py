"""Files kept of a failed test: a recording that can be replayed, scenario, configuration, seed."""

import json
import re
import shlex
from pathlib import Path

import yaml

from hilserver import __version__
from hilserver.faults.scenario import as_yaml
from hilserver.testing.hil import Hil


def keep(hil: Hil, folder: Path, test: str) -> Path:
    """Write everything that repeats the failure below `folder`; return the place."""
    place = folder / re.sub(r"[^A-Za-z0-9_.-]+", "_", test)[-120:]
    place.mkdir(parents=True, exist_ok=True)
    hil.tap.drain()
    config = hil.daemon.config
    seed = config.plant.seed
    hil.tape.write(place / "recording.mcap")
    scenario = hil.journal.scenario(f"{test} failed", seed)
    (place / "scenario.yaml").write_text(as_yaml(scenario), encoding="utf-8")
    text = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)
    (place / "config.yaml").write_text(text, encoding="utf-8")
    (place / "requirements.yaml").unlink(missing_ok=True)  # of the last failure
    if (judged := hil.tap.judged) is not None:
        required = {"require": judged.requirements}
        text = yaml.safe_dump(required, sort_keys=False)
        (place / "requirements.yaml").write_text(text, encoding="utf-8")
    run = {
        "test": test,
        "mode": hil.mode,
        "seed": seed,
        "tick": hil.tick,
        "frames_lost": hil.tape.lost,
        "version": __version__,
        "kernel": hil.daemon.core.snapshots.identity["kernels"],
        "configuration": config.sha256,
    }
    (place / "run.json").write_text(json.dumps(run, indent=1) + "\n", encoding="utf-8")
    return place


def command(hil: Hil, place: Path) -> str:
    """Return the command that repeats what is kept in `place`: no page, no port, no controller."""
    words = ["hilserver", "replay", place / "recording.mcap", "--check"]
    words += ["-o", place / "again.mcap"]
    if (judged := hil.tap.judged) is not None:
        span = f"{judged.from_s:.9g}", f"{judged.to_s:.9g}"
        words += ["--require", place / "requirements.yaml", "--between", *span]
    return shlex.join(map(str, words))

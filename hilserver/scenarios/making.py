"""A scenario on disk: the logs, the configuration to judge them with, and the sealed truth."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from hilserver_injector import Recipe, make

from hilserver.errors import FailedError
from hilserver.scenarios.expectation import ScenarioDrive, ThesisScenario

LOGS, AGAINST, SEALED, CONFIG = "logs", "against", "sealed", "config.yaml"


def write(scenario: ThesisScenario, seed: int, folder: Path) -> ScenarioDrive:
    """Write a scenario into a folder and return it; FailedError if the folder cannot be written.

    The logs are in ``logs`` (and ``against``), the truth is in ``sealed/truth.json``.
    """
    drive = scenario.draw(seed)
    try:
        _write_logs(drive.logs, folder / LOGS)
        if drive.against:
            _write_logs(drive.against, folder / AGAINST)
        head = f"# The model to judge scenario {scenario.name} with.\n"
        (folder / CONFIG).write_text(head + drive.config, encoding="utf-8")
        sealed = folder / SEALED
        sealed.mkdir(parents=True, exist_ok=True)
        expected = drive.expectation
        must_say = [sorted(names) for names in expected.must_say]
        recipes = {
            name: asdict(r) for name, r in {**drive.logs, **drive.against}.items()
        }
        document = {
            "scenario": scenario.name,
            "seed": seed,
            "thesis": scenario.says,
            "hidden": drive.hidden,
            "must_say": must_say,
            "together": sorted(expected.together),
            "must_not_say": sorted(expected.must_not_say),
            "verdict": expected.verdict,
            "recipes": recipes,
        }
        text = json.dumps(document, indent=1, default=str) + "\n"
        (sealed / "truth.json").write_text(text, encoding="utf-8")
    except OSError as error:
        raise FailedError(
            f"{folder}: cannot be written ({error.strerror}); choose another folder with -o."
        ) from None
    return drive


def _write_logs(recipes: Mapping[str, Recipe], folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, recipe in recipes.items():
        table, _ = make(recipe)
        table.write_csv(folder / name)

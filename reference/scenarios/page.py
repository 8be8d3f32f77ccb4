"""The page of the scenarios: what happens, what the diagnosis says of it, and a plot of each."""

import re
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from hilserver.daemon.assembly import assemble
from hilserver.diagnosis.pipeline import Task
from hilserver.diagnosis.pipeline import judge as diagnose
from hilserver.diagnosis.report.standalone import document
from hilserver.errors import FailedError
from hilserver.measured.reading import read_measured
from hilserver.scenarios.drives import SCENARIOS
from hilserver.scenarios.expectation import ThesisScenario
from hilserver.scenarios.making import AGAINST, CONFIG, LOGS, write
from reference.scenarios.telling import section, words
from reference.scenarios.views import VIEWS, Case

PAGE, PLOTS = "scenarios.md", "scenarios"
SEED: Final = 0
_HEAD = """\
# What the thesis says its simulation gets wrong

Seventeen drives, each with one thing hidden in it. The truth is another program than the plant, and
the logs have the channels that the robot of the thesis had. `hilserver scenarios page` writes this
page and its plots; `hilserver scenarios make NAME -o DIR` writes the logs of one. All figures here
are of seed 0: other seeds draw other sizes and, in some scenarios, other causes. Where a diagnosis
is not what it should be, the section says so.

See also [how a diagnosis comes about](diagnosis.md), [how to make one](../how-to/diagnose.md) and
[what the causes mean](../reference/findings.md).
"""
_SECTION = re.compile(r"^## `(\w+)`\n.*?(?=^## |\Z)", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True, slots=True)
class Entry:
    """A scenario on the page.

    Attributes
    ----------
    section : str
        Markdown.
    plot : str
        SVG file.
    """

    section: str
    plot: str


def make_entry(scenario: ThesisScenario, *, jobs: int = 1) -> Entry:
    """Make the drive of a scenario, diagnose it, and tell and draw what came out."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        drive = write(scenario, SEED, folder)
        logs = [folder / LOGS / log for log in drive.logs]
        against = [folder / AGAINST / log for log in drive.against]
        task = Task(
            tuple(logs), folder / CONFIG, against=tuple(against), seed=SEED, jobs=jobs
        )
        case = Case(
            diagnose(task),
            assemble(task.config).robot,
            tuple(read_measured([log]) for log in logs),
            tuple(read_measured([log]) for log in against),
        )
    plots, legend = VIEWS[scenario.name].draw(case)
    picture = f"{PLOTS}/{scenario.name}.svg"
    text = section(scenario, drive, case.diagnosis.findings, picture)
    return Entry(text, document(plots, words()[scenario.name].title, legend))


def write_page(folder: Path, made: Mapping[str, Entry]) -> None:
    """Write page and plots into a folder; scenarios that are not given keep their section.

    Raises
    ------
    FailedError
        When the folder cannot be written.
    """
    page, plots = folder / PAGE, folder / PLOTS
    try:
        plots.mkdir(parents=True, exist_ok=True)
        kept = sections(page.read_text(encoding="utf-8")) if page.exists() else {}
        for name, one in made.items():
            (plots / f"{name}.svg").write_text(one.plot, encoding="utf-8")
        all_of_them = {**kept, **{name: one.section for name, one in made.items()}}
        text = "\n".join(
            [_HEAD, *(all_of_them[n] for n in SCENARIOS if n in all_of_them)]
        )
        page.write_text(text, encoding="utf-8")
    except OSError as error:
        msg = f"{folder}: cannot be written ({error.strerror}); choose another folder with -o."
        raise FailedError(msg) from None


def sections(text: str) -> dict[str, str]:
    """Return the sections of a page by scenario."""
    return {match[1]: match[0].rstrip("\n") + "\n" for match in _SECTION.finditer(text)}

"""The page: the share that passes first, then margins, what decides, and the worst machines."""

import math
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import numpy as np
from jinja2 import ChoiceLoader, Environment, PackageLoader
from markupsafe import Markup

from hilserver import __version__
from hilserver.diagnosis.report.page import environment
from hilserver.diagnosis.report.svg import Figure
from hilserver.program.whole_file import write_whole
from hilserver.sweep.estimates import Influence, exact_interval, influences
from hilserver.sweep.report.figures import distribution, failing_region
from hilserver.sweep.table import ERROR, PASSED, REFUSED, MachineTable
from hilserver.sweep.words import details, headline, scope

REPORT: Final = "report.html"
MOST_INFLUENCES: Final = 8
N_WORST: Final = 10
MOST_MESSAGES: Final = 8


@dataclass(frozen=True)
class JudgedRequirement:
    """One requirement over all machines."""

    name: str
    unit: str
    met: int
    # share of the machines that meet it, with the exact interval
    share: float
    low: float
    high: float
    median: float
    worst: float
    influences: list[Influence]


def render(table: MachineTable) -> str:
    """Return the report as one HTML file without any reference to the network."""
    n = len(table) - table.count(REFUSED)
    judged = [_judged(table, name, n) for name in table.margins]
    units = {**table.about["units"], **dict.fromkeys(table.faults, "1")}
    low, high = exact_interval(table.count(PASSED), n)
    drawn = [distribution(j.name, table.margins[j.name], j.unit) for j in judged]
    maps = [failing_region(table, j.name, j.influences, units) for j in judged]
    figures = [figure for figure in drawn if isinstance(figure, Figure)]
    pictures = [figure for figure in maps if isinstance(figure, Figure)]
    computed = sum(bool(computer) for computer in table.computer)
    return (
        _environment()
        .get_template("sweep.html.j2")
        .render(
            about=table.about,
            headline=headline(table),
            details=details(table),
            scope=scope(table),
            n=n,
            passed=table.count(PASSED),
            interval=(low, high),
            judged=judged,
            units=units,
            figures=figures,
            maps=pictures,
            worst=_worst(table),
            errors=_counted(table, ERROR),
            refused=_counted(table, REFUSED),
            mixed=computed,
            version=__version__,
        )
    )


def write_report(folder: Path, table: MachineTable) -> Path:
    """Write the report; return the file."""
    path = folder / REPORT
    write_whole(path, render(table).encode())
    return path


def _judged(table: MachineTable, name: str, n: int) -> JudgedRequirement:
    margins = table.margins[name]
    driven = margins[~np.isnan(margins)]
    met = int((driven >= 0.0).sum())
    low, high = exact_interval(met, n)
    if len(table):
        faults = {f: v for f, v in table.faults.items() if np.ptp(v) > 0.0}
    else:
        faults = {}
    finite = np.where(np.isneginf(margins), np.nan, margins)
    unit = table.about["requirement_units"].get(name, "")
    median = float(np.median(driven)) if len(driven) else np.nan
    least = float(driven.min()) if len(driven) else np.nan
    influence = influences({**table.parameters, **faults}, finite)[:MOST_INFLUENCES]
    share = met / max(n, 1)
    return JudgedRequirement(
        name,
        unit,
        met,
        share,
        low,
        high,
        median,
        least,
        influence,
    )


def _worst(table: MachineTable) -> list[dict[str, Any]]:
    """Return machines to drive again."""
    # NaN if the controller failed: these have their own table
    size = table.worst_margin
    order = np.argsort(size, kind="stable")
    rows = [row for row in order.tolist() if not np.isnan(size[row])]
    return [
        {
            "index": int(table.index[row]),
            "margins": [
                (name, float(values[row])) for name, values in table.margins.items()
            ],
            "message": table.message[row],
            "parameters": [
                (name, float(values[row])) for name, values in table.parameters.items()
            ],
        }
        for row in rows[:N_WORST]
    ]


def _counted(table: MachineTable, status: str) -> list[tuple[str, int, int]]:
    """Return the messages of a status, their counts, and one machine with each."""
    found: dict[str, list[int]] = {}
    for row, message in enumerate(table.message):
        if table.status[row] == status:
            key = message.partition(": ")[0] if status == REFUSED else message
            found.setdefault(key, []).append(int(table.index[row]))
    ordered = sorted(found.items(), key=lambda item: -len(item[1]))
    return [(message, len(rows), rows[0]) for message, rows in ordered[:MOST_MESSAGES]]


@cache
def _environment() -> Environment:
    """Return the template environment: that of the diagnosis, with this room's templates."""
    made = environment().overlay(
        loader=ChoiceLoader(
            [
                PackageLoader("hilserver.sweep.report"),
                PackageLoader("hilserver.diagnosis.report"),
            ]
        )
    )
    own = (
        files("hilserver.sweep.report")
        .joinpath("sweep.css")
        .read_text(encoding="utf-8")
    )
    made.globals = {**made.globals, "own_style": Markup(own), "infinity": math.inf}  # noqa: S704
    return made

"""The terms: every physical cause of a deviation, as a parameter of the plant.

The table is `terms.csv`. A term at its null value changes no output bit. The name is the cause, or
``cause.part`` if a cause has several parameters; the bare cause then means its first part.
Shape parameters (a phase, a region) act only while another part of their cause is not null.
"""

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from math import isfinite
from types import MappingProxyType
from typing import Final

from hilserver.errors import meant
from hilserver.plant.errors import PlantError


@dataclass(frozen=True, slots=True)
class Term:
    """One parameter of a cause."""

    name: str  # cause, or ``cause.part``
    # part of the plant it acts in: drive, kinematics, navigation or inertial
    block: str
    unit: str  # symbol of the unit, "1" for a relative value
    null: float | None  # value at which it changes nothing; None: see `description`
    reference: float | None  # size at which a diagnosis must name it
    # range of values, ends included
    low: float
    high: float
    shape: bool  # True: it only shapes the effect of another part of its cause
    jumps: str  # which outputs jump when it changes, see `hilserver.parameters.table`
    description: str  # what it does

    @property
    def cause(self) -> str:
        """The name without its part."""
        return self.name.partition(".")[0]


def _read() -> dict[str, Term]:
    text = files("hilserver.plant").joinpath("terms.csv").read_text(encoding="utf-8")
    return {
        row["name"]: Term(
            name=row["name"],
            block=row["block"],
            unit=row["unit"],
            null=None if row["null"] == "none" else float(row["null"]),
            reference=float(row["reference"]) if row["reference"] else None,
            low=float(row["low"]),
            high=float(row["high"]),
            shape=bool(row["shape"]),
            jumps=row["jumps"],
            description=row["description"],
        )
        for row in csv.DictReader(text.splitlines())
    }


TERMS: Final[Mapping[str, Term]] = MappingProxyType(_read())


def main_part(name: str) -> str:
    """Return the full name of a term: the bare cause of several parts means its first part.

    PlantError if there is no such term.
    """
    if name in TERMS:
        return name
    for term in TERMS.values():
        if term.cause == name:
            return term.name
    causes = list(dict.fromkeys(term.cause for term in TERMS.values()))
    hint = meant(name, [*causes, *TERMS], f"the causes are {', '.join(causes)}.")
    raise PlantError(f"plant.terms.{name}: there is no such term: {hint}")


def complete(values: Mapping[str, float | None]) -> dict[str, float | None]:
    """Return a value for every term: those given, checked, and null for all others.

    PlantError if a name is unknown or given twice, or a value is not finite or out of range.

    Parameters
    ----------
    values : mapping of str to float or None
        Terms by name or bare cause; None is the null value.
    """
    result: dict[str, float | None] = {name: term.null for name, term in TERMS.items()}
    seen: set[str] = set()
    for name, value in values.items():
        term = TERMS[main_part(name)]
        if term.name in seen:
            raise PlantError(
                f"plant.terms.{name}: {term.name} is given twice; keep one."
            )
        seen.add(term.name)
        if value is None:
            continue
        if not isfinite(value) or not term.low <= value <= term.high:
            raise PlantError(
                f"plant.terms.{name}: {value:g} {term.unit} is outside "
                f"{term.low:g} .. {term.high:g} {term.unit}."
            )
        result[term.name] = float(value)
    return result

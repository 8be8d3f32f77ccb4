"""What a look is asked, and what it answers: plain data between two processes."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Self

from hilserver.recalibration.flips import Answer
from hilserver.recalibration.proposals import Quantity, Term, quantities_of, terms_of

Values = Mapping[str, float]  # terms of the plant by name; those that are off are left out


@dataclass(frozen=True)
class Todo:
    """What to do with one window, in this order."""

    window: int
    loaded: Values  # the terms of the model that runs
    measure: Values | None = None  # terms of the model before: is the one that runs better?
    # terms that were named on the window before: are they better than the one that runs?
    confirm: Values | None = None
    level: float = 0.0  # of the confirmation
    look: bool = False  # diagnose the window; not after a confirmation that holds


@dataclass(frozen=True)
class Share:
    """What a diagnosis may take of this computer, and with whom it ends."""

    nice: int = 0
    cpus: tuple[int, ...] = ()  # cores that it may run on; none: all
    memory_bytes: int = 0
    parent: int = 0


@dataclass(frozen=True)
class Order:
    """A `Todo` with all that a process needs for it."""

    todo: Todo
    path: str
    # the configuration, without passwords; relative paths in it start from `folder`
    config: Mapping[str, Any]
    folder: str
    parameters: Values  # what differs from it besides terms, by full name; NaN is null
    report: str  # folder for the report of a diagnosis
    share: Share = Share()

    def text(self) -> str:
        """Return it as text."""
        return json.dumps(asdict(self))

    @classmethod
    def of(cls, text: str) -> Self:
        """Return the order of a text."""
        data = json.loads(text)
        share = {**data["share"], "cpus": tuple(data["share"]["cpus"])}
        return cls(**{**data, "todo": Todo(**data["todo"]), "share": Share(**share)})


@dataclass(frozen=True)
class Compared(Answer):
    """How two models explain a window."""

    gain: Mapping[str, Quantity] = field(default_factory=dict)  # by quantity


@dataclass(frozen=True)
class Looked:
    """What a diagnosis of a window has found."""

    # as in docs/reference/recalibration.md
    verdict: str
    sentence: str = ""
    causes: tuple[str, ...] = ()
    # all of the model that would be proposed
    terms: Mapping[str, Term] = field(default_factory=dict)
    gone: Values = field(default_factory=dict)  # terms that run now and are not among them
    # where the terms were fitted, as in a patch
    fitted: Mapping[str, Any] = field(default_factory=dict)
    faults: tuple[str, ...] = ()  # a sentence for each fault of the data
    p: float = 1.0


@dataclass(frozen=True)
class Result:
    """What came of an order; what was not asked for is None."""

    measure: Compared | None = None
    confirm: Compared | None = None
    look: Looked | None = None
    error: str = ""

    def text(self) -> str:
        """Return it as text."""
        return json.dumps(asdict(self))

    @classmethod
    def of(cls, text: str) -> Self:
        """Return the result of a text; TypeError or ValueError or KeyError if it is none."""
        data = json.loads(text)
        compared = {key: _compared(data[key]) for key in ("measure", "confirm")}
        return cls(**compared, look=_looked(data["look"]), error=str(data["error"]))


def _compared(data: Mapping[str, Any] | None) -> Compared | None:
    return None if data is None else Compared(**{**data, "gain": quantities_of(data["gain"])})


def _looked(data: Mapping[str, Any] | None) -> Looked | None:
    if data is None:
        return None
    lists = {key: tuple(data[key]) for key in ("causes", "faults")}
    return Looked(**{**data, **lists, "terms": terms_of(data["terms"])})

"""The order for a look and its result: plain data between two processes."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Final

from pydantic import TypeAdapter

from hilserver.recalibration.flips import FlipTest
from hilserver.recalibration.proposals import STRICT, ProposedTerm, Quantity

Values = Mapping[str, float]  # terms of the plant by name; absent: off


@dataclass(frozen=True)
class Todo:
    """What to do with one window, in this order."""

    window: int
    loaded: Values  # the terms of the model that runs
    # terms of the model before: is the running one better?
    measure: Values | None = None
    # terms named on the window before: are they better than the running model?
    confirm: Values | None = None
    level: float = 0.0  # of the confirmation
    look: bool = False  # diagnose the window, unless a confirmation holds


@dataclass(frozen=True)
class Share:
    """The share of this computer that a look may use, and the process with which it ends."""

    nice: int = 0
    cpus: tuple[int, ...] = ()  # cores it may run on; empty: all
    memory_bytes: int = 0
    parent: int = 0


@dataclass(frozen=True)
class JudgeOrder:
    """A `Todo` with everything the process needs."""

    __pydantic_config__ = STRICT

    todo: Todo
    path: str
    # the configuration, without passwords; relative paths in it start from `folder`
    config: Mapping[str, Any]
    folder: str
    parameters: Values  # other values that differ from it, by full name; NaN is null
    report: str  # folder for the report of a diagnosis
    share: Share = Share()

    def text(self) -> str:
        """Return it as text."""
        return json.dumps(asdict(self))

    @classmethod
    def of(cls, text: str) -> "JudgeOrder":
        """Return the order of a text."""
        return _ORDER.validate_json(text)


@dataclass(frozen=True)
class ModelsCompared(FlipTest):
    """Which of two models explains a window better."""

    gain: Mapping[str, Quantity] = field(default_factory=dict)  # by quantity


@dataclass(frozen=True)
class Looked:
    """The findings of a window."""

    # as in docs/reference/recalibration.md
    verdict: str
    sentence: str = ""
    causes: tuple[str, ...] = ()
    # of the model that would be proposed, all of them
    terms: Mapping[str, ProposedTerm] = field(default_factory=dict)
    # running terms that would be switched off
    gone: Values = field(default_factory=dict)
    # where the terms were fitted, as in a patch
    fitted: Mapping[str, Any] = field(default_factory=dict)
    faults: tuple[str, ...] = ()  # a sentence for each fault of the data
    p: float = 1.0


@dataclass(frozen=True)
class JudgeResult:
    """The result of an order; parts that were not ordered are None."""

    __pydantic_config__ = STRICT

    measure: ModelsCompared | None = None
    confirm: ModelsCompared | None = None
    look: Looked | None = None
    error: str = ""

    def text(self) -> str:
        """Return it as text."""
        return json.dumps(asdict(self))

    @classmethod
    def of(cls, text: str) -> "JudgeResult":
        """Parse a result; ValueError if the text is not one."""
        result = _RESULT.validate_json(text)
        if missing := asdict(result).keys() - json.loads(text).keys():
            raise ValueError(f"missing: {', '.join(sorted(missing))}")
        return result


_ORDER: Final = TypeAdapter(JudgeOrder)
_RESULT: Final = TypeAdapter(JudgeResult)

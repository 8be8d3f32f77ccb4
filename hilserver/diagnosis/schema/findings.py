"""What a diagnosis says: the models of ``findings.json``."""

from collections.abc import Iterable
from enum import StrEnum
from typing import Final, Literal

from pydantic import BaseModel, ConfigDict, Field

SCHEMA: Final = "hilserver.diagnosis/1"


class Verdict(StrEnum):
    """What a finding is; each has exactly one."""

    NAMED = "named"
    NAMED_GROUP = "named_group"
    STRUCTURE_NOT_IN_LIBRARY = "structure_not_in_library"
    DRIFT = "drift"
    INSUFFICIENT_EXCITATION = "insufficient_excitation"
    DATA_FAULT = "data_fault"
    DIFFERS = "differs"
    NO_DIFFERENCE = "no_difference"


class Overall(StrEnum):
    """The verdict on the whole log."""

    FINDINGS = "findings"
    NOTHING_FOUND = "nothing_found"
    DIFFERS = "differs"
    NO_DIFFERENCE = "no_difference"


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


Interval = tuple[float, float]


class LogFile(_Model):
    """A file that was judged."""

    file: str
    sha256: str


class Parameter(_Model):
    """A fitted value with its interval of 95 %."""

    value: float
    ci95: Interval | None
    unit: str


class Gain(_Model):
    """Mean absolute error at the end of the horizon over held-out segments."""

    horizon_s: float
    before: float
    after: float
    ratio: float
    ci95: Interval | None


class Finding(_Model):
    """One thing that the simulation, or the log, gets wrong."""

    verdict: Verdict
    causes: tuple[str, ...]
    block: Literal["controller", "drive", "kinematics", "navigation", "inertial", "data", "timing"]
    parameters: dict[str, Parameter] = Field(default_factory=dict)
    p_adjusted: float | None = None
    explanation: str = ""
    separating_experiment: str | None = None
    regressors: tuple[str, ...] = ()
    gain: dict[str, Gain] = Field(default_factory=dict)


class Detectable(_Model):
    """The smallest effect of a cause that would have been seen."""

    cause: str
    size: float
    unit: str


class NotJudged(_Model):
    """A cause that the data say nothing about."""

    cause: str
    reason: str


class Findings(_Model):
    """``findings.json``."""

    schema_: Literal["hilserver.diagnosis/1"] = Field(default=SCHEMA, alias="schema")
    verdict: Overall
    logs: tuple[LogFile, ...]
    seed: int
    version: str
    config_sha256: str
    baseline: dict[str, float] = Field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    total_gain: dict[str, Gain] = Field(default_factory=dict)
    ceiling: dict[str, float] = Field(default_factory=dict)
    smallest_detectable: tuple[Detectable, ...] = ()
    not_judged: tuple[NotJudged, ...] = ()
    notices: tuple[str, ...] = ()
    model_patch: str | None = None

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


def overall(found: Iterable[Finding]) -> Overall:
    """Return the verdict on a log with these findings; too little motion to say is none."""
    named = [one for one in found if one.verdict is not Verdict.INSUFFICIENT_EXCITATION]
    return Overall.FINDINGS if named else Overall.NOTHING_FOUND

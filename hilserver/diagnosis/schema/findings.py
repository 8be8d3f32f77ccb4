"""The findings of a diagnosis: the models of ``findings.json``."""

from collections.abc import Iterable, Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import Any, ClassVar, Final, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
)

from hilserver.diagnosis.schema.decisions import Decision

SCHEMA: Final = "hilserver.diagnosis/2"
ON_OTHER_LOGS: Final = "the gain was measured on other logs: "
"""Beginning of the notice that says where the total gain comes from."""


class Verdict(StrEnum):
    """What a finding is; each has exactly one.

    The first three are the rungs of a ladder, with `STRUCTURE_NOT_IN_LIBRARY` below them: what is
    asserted of a cause differs, what predicts does not.
    """

    NAMED = "named"
    NAMED_GROUP = "named_group"
    EFFECTIVE = "effective"
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
    NOT_JUDGED = "not_judged"
    DIFFERS = "differs"
    NO_DIFFERENCE = "no_difference"


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)
    unsaid: ClassVar[Mapping[str, Any]] = {}  # values that the document omits

    @model_serializer(mode="wrap")
    def _lean(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        data: dict[str, Any] = handler(self)
        return {
            key: value
            for key, value in data.items()
            if self.unsaid.get(key, ...) != value
        }


Interval = tuple[float, float]


class LogFile(_Model):
    """A file that was judged."""

    file: str
    sha256: str


class InGroup(_Model):
    """The value of one group of logs; without an interval where its logs do not show it."""

    value: float
    ci95: Interval | None


class Parameter(_Model):
    """A fitted value with its 95 % interval.

    Attributes
    ----------
    value : float
        For a parameter that differs by group, the mean over the groups; it has no interval.
    groups : dict of str to InGroup, or None
        By group of logs, if it differs; None if it is the same in all.
    """

    value: float
    ci95: Interval | None
    unit: str
    groups: dict[str, InGroup] | None = None

    unsaid = MappingProxyType({"groups": None})


class Gain(_Model):
    """Mean absolute error at the end of the horizon over held-out segments."""

    horizon_s: float
    before: float
    after: float
    ratio: float
    ci95: Interval | None


class Matters(_Model):
    """By how much the error of one channel falls; 1: not at all.

    Attributes
    ----------
    alone : float
        Mean absolute error over held-out blocks without this cause, over that with all causes.
    with_partners : float
        The same without this cause and those whose estimates are correlated with its own: they
        take over what it explains if only it is left out.
    """

    alone: float
    with_partners: float


class Joint(_Model):
    """All fitted parameters together, in the units in which they are reported."""

    parameters: tuple[str, ...]
    value: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]


class Noise(_Model):
    """What a channel shows of its quantity: noise, resolution and limits, in its unit."""

    white_sd: float
    ou_sd: float
    ou_tau_s: float | None
    tail_dof: float | None
    step: float | None
    limits: Interval | None


class Finding(_Model):
    """One thing that the simulation, or the log, gets wrong.

    Attributes
    ----------
    halves : int
        In how many halves of the log it is found without the other half. For a half without it, the
        gains leave it out.
    """

    verdict: Verdict
    causes: tuple[str, ...]
    block: Literal[
        "controller", "drive", "kinematics", "navigation", "inertial", "data", "timing"
    ]
    parameters: dict[str, Parameter] = Field(default_factory=dict)
    p_adjusted: float | None = None
    explanation: str = ""
    separating_experiment: str | None = None
    regressors: tuple[str, ...] = ()
    gain: dict[str, Gain] = Field(default_factory=dict)
    matters: dict[str, Matters] = Field(default_factory=dict)
    halves: Literal[0, 1, 2] = 2

    unsaid = MappingProxyType({"matters": {}, "halves": 2})


class Detectable(_Model):
    """The smallest effect of a cause that would have been seen."""

    cause: str
    size: float
    unit: str


class NotJudged(_Model):
    """A cause about which the data say nothing."""

    cause: str
    reason: str


class GroupOfLogs(_Model):
    """One group of logs: its files, what its channels show, and the gain on it."""

    logs: tuple[str, ...]
    noise: dict[str, Noise] = Field(default_factory=dict)
    total_gain: dict[str, Gain] = Field(default_factory=dict)


class Findings(_Model):
    """``findings.json``.

    Attributes
    ----------
    total_gain : dict of str to Gain
        Of the patch that each half of the log forms by itself, on the other half.
    patch_gain : dict of str to Gain
        The same, for readers of version 1.
    possible_gain : dict of str to Gain
        What items without any claim would add to it; no patch holds them.
    """

    schema_: Literal["hilserver.diagnosis/2"] = Field(default=SCHEMA, alias="schema")
    verdict: Overall
    logs: tuple[LogFile, ...]
    seed: int
    version: str
    kernels: str | None = None  # hash of the compiled equations
    config_sha256: str
    baseline: dict[str, float] = Field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    total_gain: dict[str, Gain] = Field(default_factory=dict)
    patch_gain: dict[str, Gain] = Field(default_factory=dict)
    possible_gain: dict[str, Gain] = Field(default_factory=dict)
    ceiling: dict[str, float] = Field(default_factory=dict)
    joint: Joint | None = None
    noise: dict[str, Noise] = Field(default_factory=dict)
    smallest_detectable: tuple[Detectable, ...] = ()
    not_judged: tuple[NotJudged, ...] = ()
    notices: tuple[str, ...] = ()
    decisions: tuple[Decision, ...] = ()
    groups: dict[str, GroupOfLogs] | None = None
    model_patch: str | None = None

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


def overall(found: Iterable[Finding], *, is_judged: bool = True) -> Overall:
    """Return the verdict on a log with these findings; too little motion gives none.

    Parameters
    ----------
    is_judged : bool
        False if no cause could be judged: faults of the log then say nothing about the robot.
    """
    kinds = {one.verdict for one in found} - {Verdict.INSUFFICIENT_EXCITATION}
    if not is_judged and kinds <= {Verdict.DATA_FAULT}:
        return Overall.NOT_JUDGED
    return Overall.FINDINGS if kinds else Overall.NOTHING_FOUND

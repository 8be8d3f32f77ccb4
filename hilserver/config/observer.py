"""The section ``observer:``, and what a diagnosis found about noise and its own uncertainty."""

import json
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from hilserver.config.section import Section
from hilserver.errors import ConfigError
from hilserver.observer.consider import alternatives, constants, directions
from hilserver.observer.figures import READMIT_AFTER, MeasuredNoise, figures
from hilserver.observer.layout import MOST_DIRECTIONS
from hilserver.plant.parameters import RobotParameters
from hilserver.small_file import read_small

DEFAULT_SLICE = "observer"
DEFAULT_PERIOD_MS = 10.0
MOST_READ_BYTES = 10_000_000
NAV_CLOCK = "clock_offset.nav"
OLDER = "hilserver.diagnosis/1"
NAMELESS = ("structure_not_in_library", "drift")
"""Verdicts that the model is wrong in a way that no constant describes."""


class ObserverConfig(Section):
    """Where the robot is, by its wheels, gyro and navigation: an extended Kalman filter."""

    enabled: bool = Field(
        default=False, description="true: the signals estimate.* exist"
    )
    source: Literal["simulated", "measured"] = Field(
        "simulated",
        description="sensors of the simulated robot, or measured.* of the real one",
    )
    noise: str | None = Field(
        None,
        description="findings.json of a diagnosis: noise of the sensors, uncertainty of the terms;"
        " null: the noise configured in sensors, and slip is unknown",
    )
    slice: str = Field(
        DEFAULT_SLICE,
        description=f"slice in which it runs; {DEFAULT_SLICE} has {DEFAULT_PERIOD_MS:g} ms unless"
        " scheduler.slices says otherwise",
    )
    readmit_after: int = Field(
        READMIT_AFTER,
        ge=2,
        le=1000,
        description="samples refused in a row until the robot counts as carried",
    )


class _FindingsPart(BaseModel):
    """A part of findings.json; keys that the observer does not need are ignored."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)


class _Noise(_FindingsPart):
    white_sd: float = Field(ge=0)
    ou_sd: float = Field(0.0, ge=0)
    ou_tau_s: float | None = Field(None, gt=0)
    tail_dof: float | None = None
    step: float | None = Field(None, ge=0)

    def as_noise(self) -> MeasuredNoise:
        """Return the noise figures; tails are part of the variance."""
        dof = self.tail_dof
        if dof is not None and dof > 2.0:
            wider = (dof / (dof - 2.0)) ** 0.5
        else:
            wider = 1.0
        white_sd = self.white_sd * wider
        return MeasuredNoise(
            white_sd, self.ou_sd, self.ou_tau_s or 1.0, self.step or 0.0
        )


class _Joint(_FindingsPart):
    parameters: tuple[str, ...]
    covariance: tuple[tuple[float, ...], ...]

    @model_validator(mode="after")
    def _is_square(self) -> "_Joint":
        n = len(self.parameters)
        if len(self.covariance) != n or any(len(row) != n for row in self.covariance):
            raise ValueError(
                f"joint.covariance: {n} parameters need {n} rows of {n} numbers"
            )
        return self


class _Detectable(_FindingsPart):
    cause: str
    size: float = Field(ge=0)


class _Value(_FindingsPart):
    value: float


class _Finding(_FindingsPart):
    verdict: str
    parameters: dict[str, _Value] = Field(default_factory=dict)


class Found(_FindingsPart):
    """The findings of a diagnosis that the observer uses."""

    schema_: Literal["hilserver.diagnosis/2"] = Field(alias="schema")
    noise: dict[str, _Noise] = Field(default_factory=dict)
    joint: _Joint | None = None
    smallest_detectable: tuple[_Detectable, ...] = ()
    findings: tuple[_Finding, ...] = ()

    @property
    def nav_late_s(self) -> float:
        """By how much the navigation's stamps were late in the logs [s]."""
        values = [f.parameters.get(NAV_CLOCK) for f in self.findings]
        return sum(one.value for one in values if one is not None)


def load_found(path: Path) -> Found:
    """Read findings.json; ConfigError has one sentence with file, key and remedy."""
    try:
        data = json.loads(read_small(path, MOST_READ_BYTES))
    except OSError as error:
        raise ConfigError(
            f"{path}: {(error.strerror or 'cannot be read').lower()}"
        ) from None
    except (ValueError, RecursionError):
        raise ConfigError(
            f"{path}: is not JSON; name the findings.json of a diagnosis"
        ) from None
    schema = data.get("schema") if isinstance(data, dict) else None
    if schema == OLDER:
        raise ConfigError(
            f"{path}: is of schema {OLDER}; run 'hilserver diagnose' again"
        )
    try:
        return Found.model_validate(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(map(str, first["loc"])) or "the whole"
        raise ConfigError(
            f"{path}: {key}: {first['msg'].lower()}; name the findings.json of a diagnosis"
        ) from None


def constants_of(
    robot: RobotParameters, found: Found | None, readmit_after: int = READMIT_AFTER
) -> NDArray[np.float64]:
    """Return the constants `c` of the filter's kernels.

    PlantError if the findings do not fit the robot.
    """
    if found is None:
        return constants(figures(robot, {}, readmit_after=readmit_after), [])
    noise = {name: one.as_noise() for name, one in found.noise.items()}
    unknown = {one.cause: one.size for one in found.smallest_detectable}
    moved = []
    if found.joint is not None:
        moved = directions(
            robot, found.joint.parameters, np.array(found.joint.covariance)
        )
    groups = [
        {name: one.value for name, one in finding.parameters.items()}
        for finding in found.findings
        if finding.verdict == "named_group"
    ]
    moved = [*alternatives(robot, groups), *moved][:MOST_DIRECTIONS]
    wanders = any(finding.verdict in NAMELESS for finding in found.findings)
    known = figures(
        robot, noise, unknown=unknown, wanders=wanders, readmit_after=readmit_after
    )
    return constants(known, moved)

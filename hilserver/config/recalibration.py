"""The section ``recalibration:``: the model keeps up with the measured robot."""

from typing import Literal, Self

from pydantic import Field, model_validator

from hilserver.config.section import Section
from hilserver.parameters.table import PLANT, TERM


class RecalibrationConfig(Section):
    """When windows of a run in shadow mode are diagnosed, and who accepts what comes of it."""

    enabled: bool = Field(
        False, description="true: for a daemon with measured.* inputs"
    )
    folder: str = Field(
        "recalibration",
        min_length=1,
        description="windows, reports and recalibration.jsonl",
    )
    window_s: float = Field(
        1800.0, ge=60, le=7200, description="length of a window [s]"
    )
    every_s: float | None = Field(
        86400.0,
        ge=60,
        le=31e6,
        description="look at least this often [s]; null: only on a change",
    )
    false_per_year: float = Field(
        1.0,
        gt=0,
        le=100,
        description="false proposals a year that are acceptable, over all looks",
    )
    least_change: float = Field(
        0.1,
        ge=0,
        le=1,
        description="smallest change to propose, relative to the reference size of its cause",
    )
    accept: Literal["engineer", "automatic"] = Field(
        "engineer", description="automatic: what lies within `ranges` needs no engineer"
    )
    ranges: dict[str, tuple[float, float]] = Field(
        default_factory=dict,
        description="for automatic: lowest and highest value, as rotation_gain: [-0.1, 0.1]",
    )
    nice: int = Field(15, ge=0, le=19, description="niceness of a diagnosis")
    cpu: int | None = Field(
        None,
        ge=0,
        description="core of a diagnosis; null: all but that of the pacing thread",
    )
    memory_mb: float = Field(
        2000.0, ge=500, description="memory limit of a diagnosis [MB]"
    )
    limit_s: float | None = Field(
        None,
        ge=10,
        description="a diagnosis that takes longer is ended [s]; null: window_s",
    )
    max_mb: float = Field(
        1000.0, ge=20, description="total size limit of the windows on disk [MB]"
    )

    @model_validator(mode="after")
    def _ranges_are_of_terms(self) -> Self:
        for name, (low, high) in self.ranges.items():
            if f"{TERM}{name}" not in PLANT:
                raise ValueError(
                    f"ranges: there is no term '{name}'; see docs/reference/plant.md"
                )
            if low > high:
                raise ValueError(
                    f"ranges.{name}: {low:g} .. {high:g} falls; swap the two numbers"
                )
        return self

    @property
    def limit(self) -> float:
        """Longest time of a diagnosis [s]."""
        return self.window_s if self.limit_s is None else self.limit_s

"""The file of a sweep.

::

    machines: 1000
    seed: 7
    from:
      findings: diagnosis/findings.json
      population: {terms.coulomb_friction: {uniform: [0, 4]}, controller.k_i: {sd: 10}}
    drive: {scenario: course.yaml}
    controller: {python: my.py:Controller, every_ms: 20}
    require:
      - {name: arrives, signal: pose.x_m, above: 4.9, within_s: 40}
"""

from pathlib import Path
from typing import Annotated, Final, Literal, Self

from pydantic import ConfigDict, Field, field_validator, model_validator

from hilserver.config.section import Section
from hilserver.faults import Fault
from hilserver.requirements.model import MAX_REQUIREMENTS, Requirement

MOST_MACHINES = 1_000_000
LONGEST_DRIVE_S = 7_200.0
Number = Annotated[float, Field(ge=-1e12, le=1e12)]
Share = Annotated[float, Field(ge=0, le=1)]


class Distribution(Section):
    """How one parameter scatters over the machines."""

    sd: float | None = Field(
        None, gt=0, le=1e12, description="standard deviation of a normal distribution"
    )
    mean: Number | None = Field(
        None, description="mean, with sd; null: value of the configuration"
    )
    uniform: tuple[Number, Number] | None = Field(
        None, description="uniform between two limits"
    )
    values: tuple[Number, ...] | None = Field(
        None, min_length=1, max_length=1000, description="one of these, equally likely"
    )

    @model_validator(mode="after")
    def _is_one(self) -> Self:
        given = [
            key for key in ("sd", "uniform", "values") if getattr(self, key) is not None
        ]
        if len(given) != 1:
            raise ValueError("write exactly one of sd, uniform and values")
        if self.mean is not None and self.sd is None:
            raise ValueError("mean needs sd")
        if self.uniform is not None and self.uniform[0] >= self.uniform[1]:
            low, high = self.uniform
            raise ValueError(
                f"uniform goes from {low:g} up to {high:g}; swap the two numbers"
            )
        return self


class MachineSource(Section):
    """Where the machines come from."""

    findings: Path | None = Field(
        None,
        description="findings.json of a diagnosis: uncertainty of one machine (joint)",
    )
    population: dict[str, Distribution] = Field(
        {},
        max_length=100,
        description="how the machines vary: distribution by parameter",
    )

    @model_validator(mode="after")
    def _is_something(self) -> Self:
        if self.findings is None and not self.population:
            raise ValueError("name findings, a population or both")
        return self


class FaultShare(Section):
    """A fault that some of the machines have."""

    share: Share = Field(description="share of the machines that have the fault")
    fault: Fault = Field(description="fault, as in a scenario")


class DriveConfig(Section):
    """What the machines do."""

    scenario: Path | None = Field(
        None, description="set-points and faults, as for simulate"
    )
    duration_s: float | None = Field(
        None,
        gt=0,
        le=LONGEST_DRIVE_S,
        description="null: until 1 s after the scenario's last step or fault",
    )
    path: tuple[tuple[Number, Number], ...] | None = Field(
        None,
        min_length=2,
        max_length=1000,
        description="path in the plane [m]; path.error_m is the distance of the pose from it",
    )

    @model_validator(mode="after")
    def _lasts(self) -> Self:
        if self.scenario is None and self.duration_s is None:
            raise ValueError("without a scenario, duration_s is needed")
        return self


class TestedController(Section):
    """The controller under test: a block, a Python object or a process."""

    block: str | None = Field(
        None, description="file.py:function, compiled into a slice"
    )
    name: str | None = Field(
        None, description="slice of the block; null: that of its function"
    )
    slice: str = Field("sensors", description="of the block")
    inputs: dict[str, str] = Field({}, description="input of the block: signal")
    drives: dict[str, str] = Field({}, description="output of the block: command")
    parameters: dict[str, float] = Field({}, description="of the block")
    python: str | None = Field(
        None, description="file.py:Class, one instance for each machine"
    )
    every_ms: float | None = Field(
        None, gt=0, le=10_000, description="period of python"
    )
    command: tuple[str, ...] = Field(
        (),
        max_length=100,
        description="a program, started in the folder of the sweep for each machine; {endpoint}"
        " stands for the address of the robot, {seed} for the seed of the machine",
    )
    lockstep: Literal["opcua"] | None = Field(
        None, description="how the program steps the robot"
    )

    @model_validator(mode="after")
    def _is_one_kind(self) -> Self:
        given = [k for k in _KINDS if getattr(self, k)]
        if len(given) != 1:
            raise ValueError("write exactly one of block, python and command")
        (kind,) = given
        for other, (needs, *more) in _KINDS.items():
            if other == kind and not getattr(self, needs):
                raise ValueError(f"{kind} needs {needs}")
            for key in (needs, *more):
                if other != kind and getattr(self, key):
                    raise ValueError(f"{key} goes with {other}, not with {kind}")
        return self


_KINDS: Final = {
    "block": ("drives", "inputs", "name", "parameters"),
    "python": ("every_ms",),
    "command": ("lockstep",),
}
"""Keys that each kind of controller needs, and further keys that only it takes."""


class Limits(Section):
    """What one machine may use; a machine that uses more fails."""

    time_s: float = Field(60.0, gt=0, le=3600, description="wall-clock time")
    memory_mb: float = Field(
        1000.0, ge=100, le=1e6, description="beyond what a worker uses at its start"
    )


class Sweep(Section):
    """One controller against many machines."""

    model_config = ConfigDict(populate_by_name=True)

    machines: int = Field(ge=1, le=MOST_MACHINES, description="number of machines")
    seed: int = Field(0, ge=0, lt=2**31, description="seed of all draws")
    config: Path | None = Field(
        None, description="configuration of the robot; null: that of the command"
    )
    from_: MachineSource = Field(
        alias="from", description="where the machines come from"
    )
    faults: tuple[FaultShare, ...] = Field(
        (), max_length=50, description="faults that some of them have"
    )
    drive: DriveConfig = Field(description="what the machines do")
    controller: TestedController | None = Field(
        None, description="null: only the scenario"
    )
    require: tuple[Requirement, ...] = Field(
        min_length=1,
        max_length=MAX_REQUIREMENTS,
        description="what each machine must meet",
    )
    limits: Limits = Limits()

    @field_validator("faults")
    @classmethod
    def _acts_in_the_plant(
        cls, faults: tuple[FaultShare, ...]
    ) -> tuple[FaultShare, ...]:
        if any(item.fault.peer is not None for item in faults):
            raise ValueError("a machine of a sweep has no peers; name a signal")
        return faults

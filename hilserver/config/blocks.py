"""The section ``blocks``: what a user adds to the robot."""

import re
from pathlib import PurePath
from typing import Any, Self

from pydantic import Field, field_validator, model_validator

from hilserver.config.section import Section
from hilserver.config.timing import Name
from hilserver.signals import RESERVED, Ranges, robot_table

_ROBOT = robot_table(Ranges(1.0, 1.0, 1.0), body=True)
_TAKEN = RESERVED | {
    signal.name.partition(".")[0] for signal in (*_ROBOT, *_ROBOT.scalars)
}
"""First parts of the names of the robot's signals and of folders in the address space."""


class BlockConfig(Section):
    """One of the user's own blocks: a function, or an FMU."""

    name: Name = Field(
        "", description="Prefix of its output signals; default of an FMU: its file name"
    )
    function: str | None = Field(
        None, description="module:function or file.py:function"
    )
    fmu: str | None = Field(
        None, description="File of an FMU (co-simulation, FMI 2.0 or 3.0)"
    )
    slice: Name = Field("plant", description="Time slice it runs in")
    inputs: dict[str, str] = Field(default={}, description="Input of the block: signal")
    outputs: dict[str, Name] = Field(
        default={},
        description="Variable of the FMU: <output>; if empty: all outputs of the FMU",
    )
    drives: dict[str, str] = Field(
        default={},
        description="Output of the block: set-point, mode or enable that it commands from the next"
        " tick on, as source 'scenario', while that source has control",
    )
    parameters: dict[str, float] = Field(default={}, description="Parameters by name")
    start: dict[str, bool | float | str] = Field(
        default={}, description="Start values of the FMU's parameters and inputs"
    )
    process: bool = Field(
        False, description="The FMU runs in a process of its own, one slice behind"
    )

    @model_validator(mode="before")
    @classmethod
    def _name_after_file(cls, data: Any) -> Any:
        if (
            isinstance(data, dict)
            and "name" not in data
            and isinstance(data.get("fmu"), str)
        ):
            name = re.sub(r"[^A-Za-z0-9]+", "_", PurePath(data["fmu"]).stem).strip("_")
            return data | {"name": name}
        return data

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if (self.function is None) == (self.fmu is None):
            raise ValueError("name either a function or an fmu")
        if not self.name:
            raise ValueError("a block needs a name")
        of_fmu = [key for key in ("outputs", "start", "process") if getattr(self, key)]
        if self.fmu is None and of_fmu:
            raise ValueError(
                f"'{of_fmu[0]}' is for an fmu, but this block is a function"
            )
        if self.fmu is not None and self.parameters:
            raise ValueError("'parameters' is for a function; an fmu takes 'start'")
        return self

    @field_validator("name")
    @classmethod
    def _name_is_free(cls, value: str) -> str:
        if value in _TAKEN:
            raise ValueError(
                f"'{value}' is reserved for the robot or the address space"
            )
        return value

"""What all sections of the configuration have in common."""

from dataclasses import fields
from typing import Any

from pydantic import BaseModel, ConfigDict, Field


class Section(BaseModel):
    """A section of config.yaml: unknown keys are errors, nothing changes after loading."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def of(part: type, name: str) -> Any:
    """Return the field of a section with default, bounds and meaning of the plant's parameter."""
    (item,) = (one for one in fields(part) if one.name == name)
    about = item.metadata
    unit = f" [{about['unit']}]" if about["unit"] else ""
    return Field(item.default, description=about["meaning"] + unit, **about["bounds"])

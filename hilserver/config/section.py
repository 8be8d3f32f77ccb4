"""What all sections of the configuration have in common."""

from dataclasses import fields
from typing import Any
from urllib.parse import urlsplit

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


def check_endpoint(text: str) -> str:
    """Return an OPC UA endpoint as it was given.

    Raises
    ------
    ValueError
        If it is none, or holds a password that everyone could read.
    """
    try:
        parts = urlsplit(text)
        complete = parts.scheme == "opc.tcp" and parts.hostname and parts.port is not None
    except ValueError:
        complete = False
    if not complete:
        raise ValueError(f"'{text}' is not an endpoint: write opc.tcp://<host>:<port>/<path>")
    if "@" in parts.netloc:
        raise ValueError("an endpoint must not contain a user name or password")
    return text

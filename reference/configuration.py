"""The page of config.yaml, made from the models."""

import enum
import types
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from hilserver.config.root import Config

HEAD = """# Configuration: every key of config.yaml

Made from the code by `make reference`; a test keeps it up to date. A key that
is missing has its default. Names end in their units.

| key | type | default | meaning |
|---|---|---|---|
"""


def as_markdown() -> str:
    """Return the reference as Markdown."""
    return HEAD + rows_of(Config)


def rows_of(model: type[BaseModel], prefix: str = "") -> str:
    """Return a row of the table for every key of a model."""
    return "".join(
        f"| `{key}` | {_type(field.annotation)} | {_default(field)} | {_text(field)} |\n"
        for key, field in _leaves(model, prefix)
    )


def _leaves(model: type[BaseModel], prefix: str) -> Iterator[tuple[str, FieldInfo]]:
    for name, field in model.model_fields.items():
        inner, suffix = _inner_model(field.annotation)
        if inner is None:
            yield prefix + name, field
        else:
            yield from _leaves(inner, f"{prefix}{name}{suffix}.")


def _inner_model(annotation: Any) -> tuple[type[BaseModel] | None, str]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation, ""
    if get_origin(annotation) in (tuple, list) and get_args(annotation):
        inner, _ = _inner_model(get_args(annotation)[0])
        return inner, "[]"
    if get_origin(annotation) is types.UnionType:
        found = [_inner_model(inner) for inner in get_args(annotation)]
        return next((pair for pair in found if pair[0] is not None), (None, ""))
    return None, ""


def _type(annotation: Any) -> str:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        return ", ".join(f"`{value}`" for value in arguments)
    if origin in (types.UnionType, getattr(types, "UnionType", None)) or str(
        origin
    ) == ("typing.Union"):
        return " or ".join(_type(argument) for argument in arguments)
    if origin is dict:
        return f"map of {_type(arguments[1])}"
    if origin in (tuple, list):
        return f"list of {_type(arguments[0])}"
    if origin is not None and arguments:  # Annotated
        return _type(arguments[0])
    if annotation is type(None):
        return "null"
    if isinstance(annotation, type) and issubclass(annotation, enum.Enum):
        return ", ".join(f"`{member.value}`" for member in annotation)
    names = {float: "number", int: "whole number", str: "text", bool: "true or false"}
    return names.get(annotation, getattr(annotation, "__name__", str(annotation)))


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "needed"
    value = field.get_default(call_default_factory=True)
    if value is PydanticUndefined:
        return ""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, enum.Enum):
        return f"`{value.value}`"
    if isinstance(value, dict):
        return ", ".join(f"{k}: {v}" for k, v in value.items()) or "none"
    if isinstance(value, tuple | list):
        return ", ".join(str(v) for v in value) or "none"
    return f"`{value}`" if isinstance(value, str) else str(value)


def _text(field: FieldInfo) -> str:
    return (field.description or "").replace("|", "\\|")

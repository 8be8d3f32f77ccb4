"""From a YAML file to a validated model; every complaint names file, line and key."""

import difflib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ValidationError

from hilserver.errors import ConfigError

Model = TypeVar("Model", bound=BaseModel)
Path_ = Sequence[str | int]
MAX_BYTES = 1_000_000
MAX_COMPLAINTS = 20


def load(path: Path, model: type[Model]) -> Model:
    """Read, parse and validate a configuration file.

    Raises
    ------
    ConfigError
        One line per complaint: file, line, key, what is wrong and what to write instead.
    """
    root = _parse(path)
    data = _construct(path, root)
    try:
        return model.model_validate(data)
    except ValidationError as error:
        lines = [
            f"{path}:{_line(root, e['loc'])}: {_sentence(model, e)}"
            for e in error.errors(include_url=False)[:MAX_COMPLAINTS]
        ]
        raise ConfigError("\n".join(lines)) from None


def place(path: Path | None, location: Path_) -> str:
    """Return ``file:line: key: `` for a complaint found after loading, however much is known."""
    key = f"{_key(location)}: " if location else ""
    if path is None or not path.exists():
        return key
    return f"{path}:{_line(_parse(path), location)}: {key}"


def _parse(path: Path) -> yaml.Node | None:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ConfigError(f"{path}: larger than {MAX_BYTES} bytes; is it a configuration?")
        text = path.read_bytes().decode("utf-8")
        return yaml.compose(text, Loader=yaml.SafeLoader)
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: byte {error.start} is not UTF-8; save it as UTF-8") from None
    except OSError as error:
        raise ConfigError(f"{path}: {(error.strerror or 'cannot be read').lower()}") from None
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise ConfigError(f"{path}:{line}: not YAML: {error.problem}") from None
    except yaml.YAMLError as error:
        raise ConfigError(f"{path}: not YAML: {str(error).splitlines()[0]}") from None


def _construct(path: Path, root: yaml.Node | None) -> Any:
    if root is None:
        return {}
    for node in _walk(root):
        if isinstance(node, yaml.MappingNode):
            seen: dict[str, int] = {}
            for key, _ in node.value:
                line = key.start_mark.line + 1
                name = str(key.value)
                if name in seen:
                    first = seen[name]
                    raise ConfigError(
                        f"{path}:{line}: key '{name}' stands in line {first} already;"
                        " remove one of them"
                    )
                seen[name] = line
    try:
        return yaml.constructor.SafeConstructor().construct_document(root)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise ConfigError(f"{path}:{line}: {error.problem}") from None
    except ValueError as error:
        raise ConfigError(f"{path}: a value cannot be read: {error}") from None


def _walk(node: yaml.Node, depth: int = 0) -> Iterator[yaml.Node]:
    if depth > 50:
        raise ConfigError("the configuration is nested more than 50 levels deep")
    yield node
    if isinstance(node, yaml.MappingNode):
        for _, value in node.value:
            yield from _walk(value, depth + 1)
    elif isinstance(node, yaml.SequenceNode):
        for value in node.value:
            yield from _walk(value, depth + 1)


def _line(root: yaml.Node | None, location: Path_) -> int:
    """Return the line of the deepest key of `location` that the file has."""
    line, node = 1, root
    for part in location:
        if isinstance(node, yaml.MappingNode):
            found = [(k, v) for k, v in node.value if k.value == str(part)]
            if not found:
                return line
            line, node = found[0][0].start_mark.line + 1, found[0][1]
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int):
            node = node.value[part]
            line = node.start_mark.line + 1
        else:
            return line
    return line


def _key(location: Path_) -> str:
    text = ""
    for part in location:
        if isinstance(part, int):
            text += f"[{part}]"
        elif part != "[key]":
            text += f".{part}" if text else part
    return text


def _sentence(model: type[BaseModel], error: Any) -> str:
    location, kind = error["loc"], error["type"]
    key = _key(location)
    if kind == "extra_forbidden":
        known = _keys_at(model, location[:-1])
        close = difflib.get_close_matches(str(location[-1]), known, n=1, cutoff=0.5)
        hint = f"did you mean '{close[0]}'?" if close else f"known are {', '.join(sorted(known))}"
        return f"unknown key '{key}'; {hint}"
    if kind == "missing":
        return f"key '{key}' is missing"
    message = error["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    if kind in ("value_error", "assertion_error"):
        return f"{key}: {message}" if key else message
    return f"{key}: {error['input']!r:.60} does not fit; it should be {message}"


def _keys_at(model: type[BaseModel], location: Path_) -> list[str]:
    """Return the keys that the model at `location` knows."""
    current: Any = model
    for part in location:
        if isinstance(part, int):
            continue
        fields = getattr(current, "model_fields", {})
        if part not in fields:
            return []
        current = _model_in(fields[part].annotation)
    return list(getattr(current, "model_fields", {}))


def _model_in(annotation: Any) -> Any:
    """Return the model inside ``list[Model]``, ``Model | None`` and the like."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for arg in get_args(annotation) if (found := _model_in(arg))), None)

"""From a YAML file to a validated model; every complaint names file, line and key."""

import contextlib
import re
import stat
from collections.abc import Iterator, Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ValidationError

from hilserver.errors import ConfigError, meant

Model = TypeVar("Model", bound=BaseModel)
Path_ = Sequence[str | int]
MAX_BYTES = 1_000_000
# of a file that a running daemon reads: more would hold up its event loop
LIVE_BYTES = 100_000
MAX_COMPLAINTS = 20
MAX_NESTING = 50
_RENAMED = object()
MAX_VALUES = 100_000  # aliases count as often as they are used

_WANTED = {
    "model_type": "keys and values",
    "dict_type": "keys and values",
    "tuple_type": "a list",
    "list_type": "a list",
    "float_type": "a number",
    "float_parsing": "a number",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "a text",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
}
"""Kinds of errors of pydantic, in words that suit a configuration file."""
_LENGTHS = {
    "too_short": "{min_length} or more entries",
    "too_long": "at most {max_length} entries",
    "string_too_short": "a text of {min_length} or more characters",
    "string_too_long": "a text of at most {max_length} characters",
}
_SECTIONS = ("model_type", "dict_type", "tuple_type", "list_type")


def load(path: Path, model: type[Model], most_bytes: int = MAX_BYTES) -> Model:
    """Read, parse and validate a configuration file of at most `most_bytes`.

    ConfigError has one line per complaint: file, line, key, what is wrong, what to write instead.
    """
    root = _parse(path, most_bytes)
    result, complaints = _judged(model, _construct(path, root))
    if result is None or complaints:
        lines = [f"{path}:{_line(root, loc)}: {text}" for loc, text in complaints]
        raise ConfigError("\n".join(lines))
    return result


def nodes_of(path: Path) -> yaml.Node | None:
    """Return the YAML nodes of a file of other programs, within the limits of our own files.

    Keys may be there twice, and any value is what it is. ConfigError if it is not YAML.
    """
    root = _parse(path)
    for _ in _bounded(path, root):
        pass
    return root


def checked(model: type[Model], data: Any, what: str = "") -> Model:
    """Return data of a program, which has no file; ConfigError says the same of it as of a file.

    `what` begins the sentence.
    """
    result, complaints = _judged(model, data)
    if result is None or complaints:
        raise ConfigError(what + complaints[0][1])
    return result


def _judged(
    model: type[Model], data: Any
) -> tuple[Model | None, list[tuple[Path_, str]]]:
    """Return the model if it can be made, and what is wrong: locations and sentences."""
    try:
        result = model.model_validate(data)
    except ValidationError as error:
        errors = error.errors(include_url=False)[:MAX_COMPLAINTS]
        causes = [e for e in errors if not _is_echo(e)]
        return None, [(e["loc"], _sentence(model, e)) for e in causes]
    complaints = [
        (at, f"{_key(at)}: {value!r:.60} is not valid; it should be {wanted}")
        for at, value, wanted in _mistyped(data, result)
    ]
    return result, complaints[:MAX_COMPLAINTS]


def place(path: Path | None, location: Path_) -> str:
    """Return ``file:line: key: `` for a complaint after loading, as far as known."""
    key = f"{_key(location)}: " if location else ""
    if path is None or not path.exists():
        return key
    return f"{path}:{_line(_parse(path), location)}: {key}"


@contextlib.contextmanager
def placed(path: Path | None, location: Path_) -> Iterator[None]:
    """Let errors about a part of a file begin with its place; they become ConfigErrors."""
    try:
        yield
    except (ValueError, ConfigError) as error:
        raise ConfigError(f"{place(path, location)}{error}") from None


def _parse(path: Path, most_bytes: int = MAX_BYTES) -> yaml.Node | None:
    content = _read(path, most_bytes)
    depth = 0
    try:
        text = content.decode("utf-8")
        # Check the depth by events first, which come one by one: composing is recursive.
        for event in yaml.parse(text, Loader=yaml.SafeLoader):
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > MAX_NESTING:
                raise _too_deep(path, event.start_mark)
        return yaml.compose(text, Loader=yaml.SafeLoader)
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ConfigError(
            f"{path}:{line}: byte {error.start} is not UTF-8; save it as UTF-8"
        ) from None
    except yaml.MarkedYAMLError as error:
        if "'\\t'" in str(error.problem):
            hint = "; indent with spaces, not with tabs"
        else:
            hint = ""
        raise _wrong(
            path, error.problem_mark, f"not YAML: {error.problem}{hint}"
        ) from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise ConfigError(
            f"{path}:{line}: not YAML: {str(error).splitlines()[0]}"
        ) from None


def _read(path: Path, most_bytes: int) -> bytes:
    try:
        mode = path.stat().st_mode
        if stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode):
            raise ConfigError(
                f"{path}: is not a regular file; it is read more than once"
            )
        with path.open("rb") as file:
            content = file.read(most_bytes + 1)
    except OSError as error:
        raise ConfigError(
            f"{path}: {(error.strerror or 'cannot be read').lower()}"
        ) from None
    if len(content) > most_bytes:
        raise ConfigError(
            f"{path}: larger than {most_bytes} bytes; is it the right file?"
        )
    return content


def _too_deep(path: Path, mark: Any) -> ConfigError:
    return _wrong(path, mark, f"nested more than {MAX_NESTING} levels deep; flatten it")


def _wrong(path: Path, mark: Any, text: str) -> ConfigError:
    return ConfigError(f"{path}:{mark.line + 1 if mark else 1}: {text}")


_NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
_OCTAL = re.compile(r"[-+]?0[0-7_]+")
_POWER_OF_TEN = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+")
_UNREADABLE = (ValueError, LookupError, AttributeError)
"""Raised by YAML's reader for ``!!float ''``, ``!!bool maybe``, ``!!timestamp x``."""


def _construct(path: Path, root: yaml.Node | None) -> Any:
    if root is None:
        return {}
    for node in _bounded(path, root):
        if isinstance(node, yaml.ScalarNode):
            misread = _misread(node)
            if misread:
                raise _wrong(path, node.start_mark, misread)
            if _is_power_of_ten(node):
                node.tag = "tag:yaml.org,2002:float"  # YAML 1.1 wants 1.0e+3
        if isinstance(node, yaml.MappingNode):
            seen: dict[str, int] = {}
            for key, _ in node.value:
                name = str(key.value)
                if name in seen:
                    text = f"key '{name}' is already in line {seen[name]}; remove one of them"
                    raise _wrong(path, key.start_mark, text)
                seen[name] = key.start_mark.line + 1
    try:
        found = yaml.constructor.SafeConstructor().construct_document(root)
    except yaml.MarkedYAMLError as error:
        raise _wrong(path, error.problem_mark, str(error.problem)) from None
    except _UNREADABLE as error:
        node = next(node for node, _ in _walk(root) if not _is_readable(node))
        kind = node.tag.rpartition(":")[2]
        if isinstance(error, ValueError):
            why = str(error)
        else:
            why = f"{node.value!r:.60} is not type {kind}"
        raise _wrong(path, node.start_mark, f"a value cannot be read: {why}") from None
    return {} if found is None else found


def _bounded(path: Path, root: yaml.Node | None) -> Iterator[yaml.Node]:
    """Yield every node, as often as aliases use it; ConfigError if there are too many."""
    for number, (node, depth) in enumerate(() if root is None else _walk(root)):
        if depth > MAX_NESTING:
            raise _too_deep(path, node.start_mark)
        if number >= MAX_VALUES:
            raise _wrong(
                path,
                node.start_mark,
                f"more than {MAX_VALUES} values; use fewer aliases",
            )
        yield node


def _misread(node: yaml.ScalarNode) -> str:
    """Return what is wrong with a value that YAML reads as nobody means it."""
    is_number = node.tag in _NUMBERS and node.style is None
    if is_number and ":" in node.value:
        return f"YAML reads {node.value} as a base-60 number; write the plain number"
    if is_number and _OCTAL.fullmatch(node.value):
        number = int(node.value.replace("_", ""), 8)
        return f"YAML reads {node.value} as the octal number {number}; write it without 0 in front"
    if "\0" in node.value:
        return "a text contains the character NUL, which file names cannot contain; remove it"
    return ""


def _is_power_of_ten(node: yaml.ScalarNode) -> bool:
    is_text = node.tag == "tag:yaml.org,2002:str" and node.style is None
    return is_text and _POWER_OF_TEN.fullmatch(node.value) is not None


def _is_readable(node: yaml.Node) -> bool:
    try:
        if isinstance(node, yaml.ScalarNode):
            yaml.constructor.SafeConstructor().construct_document(node)
    except _UNREADABLE:
        return False
    return True


def _walk(node: yaml.Node, depth: int = 0) -> Iterator[tuple[yaml.Node, int]]:
    """Yield every node with its depth, as often as aliases use it."""
    yield node, depth
    if isinstance(node, yaml.MappingNode):
        for _, value in node.value:
            yield from _walk(value, depth + 1)
    elif isinstance(node, yaml.SequenceNode):
        for value in node.value:
            yield from _walk(value, depth + 1)


def _mistyped(
    data: Any, result: Any, at: Path_ = ()
) -> Iterator[tuple[Path_, object, str]]:
    """Yield place, value and what is wanted, where pydantic has made another type of a value.

    YAML reads ``yes`` and ``on`` as true, which is no number; a number in quotes is a text, which
    other readers of the file refuse; and 1 is neither true nor false.
    """
    is_switch = isinstance(result, bool)
    if isinstance(data, bool):
        if not is_switch:
            yield at, data, "a number"
    elif isinstance(data, str | int | float) and is_switch:
        yield at, data, "true or false"
    elif isinstance(data, str) and isinstance(result, int | float):
        if not isinstance(result, Enum):
            is_padded = len(data) > 1 and data.isdecimal() and data.startswith("0")
            yield (
                at,
                data,
                "a number, without " + ("0 in front" if is_padded else "quotes"),
            )
    elif isinstance(data, dict):
        for key, value in data.items():
            if isinstance(result, Mapping):
                inner = result.get(key, _RENAMED)
            else:
                inner = getattr(result, key, _RENAMED)
            if inner is not _RENAMED:  # by a validator
                yield from _mistyped(value, inner, (*at, key))
    elif isinstance(data, list) and isinstance(result, Sequence):
        for index, (value, inner) in enumerate(zip(data, result, strict=False)):
            yield from _mistyped(value, inner, (*at, index))


def _line(root: yaml.Node | None, location: Path_) -> int:
    """Return the line of the deepest key of `location` that the file has."""
    line = 1
    node = root
    for part in location:
        if isinstance(node, yaml.MappingNode):
            found = [(k, v) for k, v in node.value if k.value == str(part)]
            if not found:
                return line
            line = found[0][0].start_mark.line + 1
            node = found[0][1]
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int):
            if part >= len(node.value):  # added by a sweep, from another file
                return line
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


def _is_echo(error: Any) -> bool:
    """Whether pydantic only says that entries are missing because it has refused them."""
    if error["type"] != "too_short":
        return False
    wanted = int(error["ctx"]["min_length"])
    return len(error["input"]) >= wanted


def _sentence(model: type[BaseModel], error: Any) -> str:
    location = error["loc"]
    kind = error["type"]
    key = _key(location)
    if kind == "extra_forbidden":
        known = _keys_at(model, location[:-1])
        name = str(location[-1])
        places = [f"'{place}'" for place in _places_of(model, name)]
        if len(places) in (1, 2):
            belongs = f"did you mean {' or '.join(places)}?"
        else:
            belongs = ""
        hint = meant(name, known, belongs or f"known are {', '.join(sorted(known))}")
        return f"unknown key '{key}'; {hint}"
    if kind == "missing":
        return f"key '{key}' is missing"
    if kind == "invalid_key" or (
        location and location[-1] == "[key]" and kind == "string_type"
    ):
        name = ".".join(str(part) for part in location if part != "[key]")
        return f"key '{name}' is not text; keys are words, and decimal numbers have a point"
    if kind in _SECTIONS and error["input"] is None:
        below = "entries" if _WANTED[kind] == "a list" else "keys"
        return f"{key}: is empty; remove it or add its {below}"
    if kind == "model_type" and not location:
        found = "a list" if isinstance(error["input"], list) else repr(error["input"])
        return f"write 'key: value' lines, not {found:.60}"
    message = (
        error["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    )
    if kind in ("value_error", "assertion_error"):
        return f"{key}: {message}" if key and not message.startswith(key) else message
    if kind == "string_pattern_mismatch":
        message = f"text that matches {error['ctx']['pattern']}"
    wanted = _WANTED.get(kind, message)
    if kind in _LENGTHS:
        wanted = _LENGTHS[kind].format_map(error["ctx"])
    if wanted == "a number" and "," in str(error["input"]):
        wanted += " with a decimal point"
    return f"{key}: {error['input']!r:.60} is not valid; it should be {wanted}"


def _keys_at(model: type[BaseModel], location: Path_) -> list[str]:
    """Return the keys that the model at `location` knows."""
    current: Any = model
    for part in location:
        if isinstance(part, int):
            continue
        fields = _fields(current)
        if part not in fields:
            return []
        current = _model_in(fields[part].annotation)
    return list(_fields(current))


def _fields(model: Any) -> dict[str, Any]:
    """Return the fields of a model by their names in a file."""
    fields = getattr(model, "model_fields", {})
    return {field.alias or name: field for name, field in fields.items()}


def _places_of(model: Any, name: str) -> Iterator[str]:
    """Yield every place below a model where a key exists."""
    for part, field in _fields(model).items():
        if part == name:
            yield part
        for place in _places_of(_model_in(field.annotation), name):
            yield f"{part}.{place}"


def _model_in(annotation: Any) -> Any:
    """Return the model inside ``list[Model]``, ``Model | None`` and the like."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(
        (found for arg in get_args(annotation) if (found := _model_in(arg))), None
    )

"""What a browser sends is looked at before anybody works with it: how much, of which type."""

from collections.abc import Sequence
from typing import Any

from hilserver.io.opcua_server.method_table import STRING
from hilserver.signals.numbers import is_finite_number

ANY = ""
_RANGES = {"Byte": (0, 2**8 - 1), "UInt32": (0, 2**32 - 1), "Int64": (-(2**63), 2**63 - 1)}
_WORDS = {
    STRING: "text",
    "Double": "a finite number",
    "Boolean": "true or false",
    "Byte": "an integer from 0 to 255",
    "UInt32": "an integer, not negative",
    "Int64": "an integer",
}


class WrongTypeError(Exception):
    """The arguments of a call do not fit; the sentence says what does."""


def fit(value: Any, kind: str) -> bool:
    """Whether a value from JSON can become one of this type; numbers pass for a name."""
    if kind == ANY:
        return True
    if kind == STRING:
        return is_finite_number(value) or (isinstance(value, str) and _is_unicode(value))
    if kind == "Boolean":
        return isinstance(value, bool) or value in (0, 1)
    if not is_finite_number(value):
        return False
    low, high = _RANGES.get(kind, (value, value))
    return low <= value <= high and (kind not in _RANGES or float(value).is_integer())


def check(name: str, given: Sequence[Any], wanted: Sequence[str], optional: int = 0) -> None:
    """Look at the arguments of a call; WrongTypeError says what is wrong."""
    if not len(wanted) - optional <= len(given) <= len(wanted):
        raise WrongTypeError(f"{name} takes {len(wanted)} arguments, not {len(given)}")
    for number, (value, kind) in enumerate(zip(given, wanted, strict=False), 1):
        if not fit(value, kind):
            raise WrongTypeError(f"{name}: argument {number} should be {_WORDS[kind]}")


def check_value(name: str, value: Any, kind: str) -> None:
    """Look at the value for a signal; WrongTypeError says what it should be."""
    if not fit(value, kind):
        raise WrongTypeError(f"{name} should be {_WORDS[kind]}")


def _is_unicode(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True

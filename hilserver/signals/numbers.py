"""What counts as a number in data from outside, such as files and JSON."""

from sys import float_info
from typing import TypeGuard


def is_finite_number(value: object) -> TypeGuard[int | float]:
    """Whether `value` is a number, not a boolean, that fits a double; integers of JSON may not.

    Examples
    --------
    >>> [is_finite_number(v) for v in (1, 0.5, True, "1", float("nan"), 10**400)]
    [True, True, False, False, False, False]
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= float_info.max

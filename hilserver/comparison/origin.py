"""What differs in where two recordings come from: configuration, versions, kernels, patch."""

from collections.abc import Iterator, Mapping
from typing import Any, Final, NamedTuple

from hilserver.logs.provenance import configuration_of

_OF_THE_RUN: Final = ("version", "kernels", "seed", "base_period_ns", "patch")
_ABSENT: Final = "(not set)"


class OriginChange(NamedTuple):
    """One entry that is not the same, by its key, and its two values as text."""

    key: str
    a: str
    b: str


def changes_between(
    a: Mapping[str, Any] | None, b: Mapping[str, Any] | None
) -> list[OriginChange]:
    """Return what differs between two runs; nothing for logs of others, which do not say."""
    if a is None or b is None:
        return []
    entries_a = dict(_entries(a))
    entries_b = dict(_entries(b))
    keys = [*entries_a, *(key for key in entries_b if key not in entries_a)]
    return [
        OriginChange(key, entries_a.get(key, _ABSENT), entries_b.get(key, _ABSENT))
        for key in keys
        if entries_a.get(key) != entries_b.get(key)
    ]


def _entries(run: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for key in _OF_THE_RUN:
        yield key, f"{run.get(key)}"
    try:
        configuration = configuration_of(run)
    except ValueError:
        return
    yield from _flat(configuration)


def _flat(node: Any, key: str = "") -> Iterator[tuple[str, str]]:
    if not isinstance(node, Mapping):
        yield key, f"{node}"
        return
    for name, inner in node.items():
        yield from _flat(inner, f"{key}.{name}" if key else str(name))

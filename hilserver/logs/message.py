"""A frame as a message: CDR with a ros2msg schema, which Foxglove and PlotJuggler read.

All numbers of a message have a fixed position, so a thousand messages are one NumPy array. The
dots of the signal names become nested messages: ``wheel.fl.speed_rpm`` has this path there, too.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

SCHEMA_NAME = "hilserver/msg/Frame"
CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
OWN = ("number", "segment", "tick", "planned_ns")
"""Numbers of the frame itself; the last is the planned start on CLOCK_MONOTONIC."""


@dataclass
class _Group:
    """A nested message while the tree is built."""

    type_name: str
    field_name: str = ""
    groups: dict[str, "_Group"] = field(default_factory=dict)
    leaves: dict[str, str] = field(default_factory=dict)
    taken: set[str] = field(default_factory=set)

    def claim(self, name: str) -> str:
        """Return `name`, followed by underscores if a group and a signal share it."""
        while name in self.taken:
            name += "_"
        self.taken.add(name)
        return name


@dataclass(frozen=True)
class MessageLayout:
    """Order and schema of a message."""

    names: tuple[str, ...]  # signals in the order in which the message holds them
    schema: str  # the ros2msg text

    @property
    def dtype(self) -> np.dtype[np.void]:
        """One message as a packed NumPy record."""
        return payload_dtype(len(self.names))


def payload_dtype(n_signals: int) -> np.dtype[np.void]:
    """Return one message of `n_signals` as a packed NumPy record."""
    return np.dtype(
        [("cdr", "S4")]
        + [(name, "<i8") for name in OWN]
        + [("values", "<f8", (n_signals,)), ("status", "<u4", (n_signals,))]
    )


def make_layout(names: Sequence[str]) -> MessageLayout:
    """Arrange signals into a message."""
    root = _Group("Frame")
    for name in names:
        *path, leaf = name.split(".")
        group = root
        for part in path:
            if part not in group.groups:
                own = group.claim(part)
                prefix = "" if group is root else group.type_name
                camel_case = "".join(
                    part[:1].upper() + part[1:] for part in own.split("_")
                )
                group.groups[part] = _Group(prefix + camel_case, own)
            group = group.groups[part]
        group.leaves[group.claim(leaf)] = name
    order: list[str] = []
    texts: list[str] = []
    _collect(root, order, texts)
    own = "".join(f"int64 {name}\n" for name in OWN)
    own_type = f"{'=' * 80}\nMSG: hilserver/RecordedFrame\n{own}"
    head = f"hilserver/RecordedFrame {root.claim('frame')}\n"
    status = f"uint32[{len(order)}] {root.claim('status')}\n"
    return MessageLayout(
        tuple(order), head + texts[0] + status + own_type + "".join(texts[1:])
    )


def _collect(group: _Group, order: list[str], texts: list[str]) -> None:
    """Write a group's definition, its leaves first, then those of its own groups."""
    lines = [f"float64 {leaf}\n" for leaf in group.leaves]
    lines += [
        f"hilserver/{inner.type_name} {inner.field_name}\n"
        for inner in group.groups.values()
    ]
    head = "" if not texts else f"{'=' * 80}\nMSG: hilserver/{group.type_name}\n"
    texts.append(head + "".join(lines))
    order.extend(group.leaves.values())
    for inner in group.groups.values():
        _collect(inner, order, texts)

"""The layout of the arena.

The arena is one file in shared memory, viewed both as float64 and as int64. It begins with the
control words, see `word`; a JSON text that names every signal and region follows, then the
regions.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hilserver.signals import SignalTable

MAGIC = 0x48494C5345525652  # "HILSERVR"
VERSION = 1
N_CONTROL_WORDS = 64
JSON_WORDS = 32768

REQUEST_SAVE = 1
REQUEST_LOAD = 2
REQUEST_RESTART = 4

ROW_WORDS = 4  # tick, slot, value, status
FRAME_HEADER_WORDS = 4  # sequence, tick, planned_ns, rows of `now` latched so far
READ_TRIES = 8  # of the newest frame, which the writer may overwrite meanwhile


@dataclass(frozen=True)
class Region:
    """A piece of the arena: offset and length in words of 8 bytes."""

    base: int
    length: int


@dataclass(frozen=True)
class Layout:
    """All regions of an arena by name, and the total number of words."""

    regions: dict[str, Region]
    ring_length: int
    queue_rows: int
    n_slots: int
    total_words: int

    @property
    def stride(self) -> int:
        """Words of one published frame."""
        return FRAME_HEADER_WORDS + 2 * self.n_slots


def padded(length: int) -> int:
    """Return the words that a region occupies; each begins at a cache line."""
    return length + (-length) % 8


def make_layout(
    n_slots: int,
    *,
    ring_length: int,
    queue_rows: int,
    live: dict[str, int],
    fixed: dict[str, int],
) -> Layout:
    """Place every region.

    Parameters
    ----------
    n_slots : int
        Scalars in a frame.
    ring_length : int
        Number of published frames that are kept, a power of two.
    queue_rows : int
        Capacity of each input queue, a power of two.
    live, fixed : dict of int
        Words of further regions by name; those in `live` are part of a snapshot.
    """
    for name, number in (("ring_length", ring_length), ("queue_rows", queue_rows)):
        if number < 1 or number & (number - 1):
            raise ValueError(f"{name} is {number}; it must be a power of two")
    regions: dict[str, Region] = {}
    position = N_CONTROL_WORDS + JSON_WORDS

    def place(name: str, length: int) -> None:
        nonlocal position
        regions[name] = Region(position, length)
        position += padded(length)

    place("frame", n_slots)
    place("status", n_slots)
    for name, length in live.items():
        place(name, length)
    live_words = position - regions["frame"].base
    place("shadow", live_words)
    for name, length in fixed.items():
        place(name, length)
    place("now", queue_rows * ROW_WORDS)
    place("timed", queue_rows * ROW_WORDS)
    place("ring", ring_length * (FRAME_HEADER_WORDS + 2 * n_slots))
    regions["live"] = Region(regions["frame"].base, live_words)
    return Layout(regions, ring_length, queue_rows, n_slots, position)


def describe(table: SignalTable, layout: Layout, run: Mapping[str, Any]) -> bytes:
    """Return the JSON text of the header, which another process needs to read the arena."""
    signals: list[dict[str, Any]] = [
        {
            "name": s.name,
            "unit": s.unit,
            "type": s.type.value,
            "direction": s.direction.value,
            "slots": list(s.slots),
            "hidden": s.hidden,
        }
        for s in (*table.scalars, *(s for s in table if s.is_array))
    ]
    regions = {
        name: [region.base, region.length] for name, region in layout.regions.items()
    }
    text = json.dumps(
        {"signals": signals, "regions": regions, "run": dict(run)}
    ).encode()
    if len(text) > JSON_WORDS * 8:  # leave out the largest part; a replay then needs -c
        rest = {key: value for key, value in run.items() if key != "configuration"}
        text = json.dumps(
            {"signals": signals, "regions": regions, "run": rest}
        ).encode()
    if len(text) > JSON_WORDS * 8:
        raise ValueError(
            f"{len(table)} signals are too many for the header of the process image"
        )
    return text

"""A log in another format, without the loss of a bit."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilserver.image import FrameBatch
from hilserver.logs.log import NS_PER_S, Log
from hilserver.logs.provenance import SCHEMA
from hilserver.logs.table import BLOCK, SEGMENT, TIME
from hilserver.logs.writer import LogWriter, Segmented
from hilserver.status import BAD_NO_DATA

ROWS_AT_ONCE: Final = 1024
GAP_NS: Final = NS_PER_S
"""Time between the stamps of two segments, which are placed one after the other."""


def run_of(log: Log) -> dict[str, Any]:
    """Return what a writer must know about a log: its run, or a table of its columns."""
    if log.run is not None:
        known = {signal["name"]: signal for signal in log.run["signals"]}
        return {**log.run, "signals": [known[name] for name in log.columns]}
    names = [TIME, *([] if log.block is None else [BLOCK]), *log.columns]
    signals = [
        {"name": name, "unit": "1", "slots": [slot], "direction": "in"}
        for slot, name in enumerate(names)
    ]
    return {
        "schema": SCHEMA,
        "foreign": True,
        "base_period_ns": 1,
        "configuration": None,
        "signals": signals,
    }


def rewrite(log: Log, writer: LogWriter) -> None:
    """Write all of a log; the caller opened the writer with `run_of` and every slot."""
    states = sorted(log.states, key=lambda state: (state.segment, state.tick))
    changes = sorted(log.changes, key=lambda change: (change.segment, change.tick))
    for batch in _batches(log):
        end = int(batch.segments[-1]), int(batch.frames.ticks[-1])
        while states and (states[0].segment, states[0].tick) <= end:
            writer.add_state(states.pop(0))
        held = [change for change in changes if (change.segment, change.tick) <= end]
        changes = changes[len(held) :]
        writer.write(replace(batch, changes=held))
    for state in states:
        writer.add_state(state)


def _batches(log: Log) -> Iterator[Segmented]:
    columns = dict(log.columns)
    if log.run is None:
        own = {TIME: log.t_s} | (
            {} if log.block is None else {BLOCK: log.block.astype(np.float64)}
        )
        columns = own | columns
    values = (
        np.stack(list(columns.values()), axis=1) if columns else np.zeros((len(log), 0))
    )
    status = np.where(np.isnan(values), BAD_NO_DATA, 0).astype(np.int64)
    for place, name in enumerate(columns):
        if name in log.status:
            status[:, place] = log.status[name]
    period_ns = int((log.run or {}).get("base_period_ns", 1))
    ticks = np.rint(log.t_s * (NS_PER_S / period_ns)).astype(np.int64)
    words = np.concatenate(
        [
            ticks[:, None],
            stamps(log)[:, None],
            np.zeros((len(ticks), 1), np.int64),
            status,
        ],
        axis=1,
    )
    for first in range(0, len(ticks), ROWS_AT_ONCE):
        rows = slice(first, first + ROWS_AT_ONCE)
        yield Segmented(FrameBatch(first, words[rows], values[rows]), log.segment[rows])


def stamps(log: Log) -> NDArray[np.int64]:
    """Return stamps that rise over all segments [ns]."""
    own = np.rint(log.t_s * NS_PER_S).astype(np.int64)
    begins = np.flatnonzero(np.diff(log.segment, prepend=log.segment[:1] - 1))
    ends = np.append(begins[1:], len(own))
    offset = 0
    result = own.copy()
    for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
        if begin:
            offset = max(int(result[begin - 1]) + GAP_NS - int(own[begin]), offset)
        result[begin:end] = own[begin:end] + offset
    return result


def as_table(log: Log) -> dict[str, NDArray[Any]]:
    """Return a log as columns with time, segment and block, for tables."""
    block: Mapping[str, NDArray[Any]] = {} if log.block is None else {BLOCK: log.block}
    return {TIME: log.t_s, SEGMENT: log.segment, **block, **log.columns}


def write_table_csv(log: Log, path: Path) -> None:
    """Write a foreign log: no file next to it, empty where there is no sample."""
    columns = as_table(log)
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(",".join(columns) + "\n")
        for row in rows:
            file.write(",".join("" if x != x else repr(x) for x in row) + "\n")  # noqa: PLR0124

"""The set-points of foreign tables and bags, through a mapping."""

from pathlib import Path

import numpy as np

from hilserver.daemon.assembly import Assembly, assemble_config
from hilserver.errors import LogError
from hilserver.logs import Log
from hilserver.measured.data import MeasuredLog
from hilserver.measured.machine import machine_config
from hilserver.measured.names import is_input
from hilserver.measured.reading import read_measured


def mapped_inputs(path: Path, mapping: str | None, assembly: Assembly) -> tuple[Log, Assembly]:
    """Read the set-points of a foreign log, or LogError, and the robot of its mapping."""
    measured = read_measured([path], mapping)
    if not measured.plant:
        return _inputs(path, measured), assembly
    config = machine_config(measured, assembly.config)
    return _inputs(path, measured), assemble_config(config, assembly.folder, assembly.patch)


def _inputs(path: Path, measured: MeasuredLog) -> Log:
    """Return the inputs as a table; empty where a row has none."""
    inputs = {name: c for name, c in measured.channels.items() if is_input(name)}
    if not inputs:
        raise LogError(f"{path}: has no set-points; map a column or topic to a set-point")
    keys = {name: np.stack([c.span, c.t_s], axis=1) for name, c in inputs.items()}
    rows, own = np.unique(np.concatenate(list(keys.values())), axis=0, return_inverse=True)
    columns, begin = {}, 0
    for name, channel in inputs.items():
        columns[name] = np.full(len(rows), np.nan)
        columns[name][own[begin : begin + len(channel)]] = channel.values
        begin += len(channel)
    numbers = np.array([span.number for span in measured.spans], dtype=np.int64)
    segment = numbers[rows[:, 0].astype(np.int64)]
    return Log(path, rows[:, 1] - rows[:, 1].min(), segment, columns, notices=measured.notices)

"""Origin of a replay: the robot of a recording, or the set-points of a log of others."""

from pathlib import Path

import numpy as np

from hilserver.config.patch import Patch, patch_of
from hilserver.config.root import Config
from hilserver.daemon.assembly import Assembly, assemble_config
from hilserver.errors import ConfigError, LogError
from hilserver.logs import Log
from hilserver.logs.provenance import configuration_of
from hilserver.measured.data import MeasuredLog
from hilserver.measured.machine import machine_config
from hilserver.measured.names import is_input
from hilserver.measured.reading import read_measured

SECTIONS = (
    *(
        "plant",
        "kinematics",
        "mechatronic",
        "sensors",
        "scheduler",
        "observer",
        "blocks",
    ),
    "recalibration",  # its samples are signals
)
"""What the plant depends on; addresses and passwords of the run do not matter."""


def assembly_of(log: Log, patch: Patch | None = None) -> Assembly:
    """Build the assembly of the recorded run, or the same with another patch.

    LogError if the recording has no configuration, or one of another version; ConfigError if a file
    that it names (hall, own block) is missing.
    """
    if log.run is None or log.run.get("configuration") is None:
        raise LogError(
            f"{log.path}: contains no configuration; give that of its run with -c"
        )
    try:
        data = configuration_of(log.run)
        config = Config.model_validate({k: data[k] for k in SECTIONS if k in data})
        laid_over = patch or patch_of(log.run)
    except (ValueError, TypeError, KeyError):
        raise LogError(
            f"{log.path}: its configuration does not match this version"
            f" ({log.run.get('version', 'unknown')} made it); give one with -c and --as-inputs"
        ) from None
    try:
        return assemble_config(
            config, Path(log.run.get("config_folder", "")), laid_over
        )
    except ConfigError as error:
        raise ConfigError(
            f"{log.path}: its configuration cannot be used here: {error}; give the right one"
            " with -c"
        ) from None


def mapped_inputs(
    path: Path, mapping: str | None, assembly: Assembly
) -> tuple[Log, Assembly]:
    """Read the set-points of a foreign log, or LogError, and the robot of its mapping."""
    measured = read_measured([path], mapping)
    if not measured.plant:
        return _inputs(path, measured), assembly
    config = machine_config(measured, assembly.config)
    return _inputs(path, measured), assemble_config(
        config, assembly.folder, assembly.patch
    )


def _inputs(path: Path, measured: MeasuredLog) -> Log:
    """Return the inputs as a table, with no value where a row has none."""
    inputs = {name: c for name, c in measured.channels.items() if is_input(name)}
    if not inputs:
        raise LogError(
            f"{path}: has no set-points; map a column or topic to a set-point"
        )
    keys = {name: np.stack([c.span, c.t_s], axis=1) for name, c in inputs.items()}
    rows, own = np.unique(
        np.concatenate(list(keys.values())), axis=0, return_inverse=True
    )
    columns = {}
    begin = 0
    for name, channel in inputs.items():
        columns[name] = np.full(len(rows), np.nan)
        columns[name][own[begin : begin + len(channel)]] = channel.values
        begin += len(channel)
    numbers = np.array([span.number for span in measured.spans], dtype=np.int64)
    segment = numbers[rows[:, 0].astype(np.int64)]
    ticks = rows[:, 1] - rows[:, 1].min()
    return Log(path, ticks, segment, columns, notices=measured.notices)

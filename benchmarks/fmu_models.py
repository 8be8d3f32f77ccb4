"""A paced drive with an FMU: ticks missed, how it ended, whether a replay reproduces it."""

import asyncio
import contextlib
import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hilserver.commands import main
from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.errors import EXIT_DONE
from hilserver.fmu.description import read_fmu

SETTLE_S = 1.0


@dataclass(frozen=True)
class Model:
    """An FMU as a block."""

    path: Path
    process: bool = False
    start: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Drive:
    """Result of a drive."""

    process: bool
    ticks: int
    missed: int  # ticks that the plant skipped
    state: str
    reason: str  # of the state
    events: list[str]
    # "equal", "differs", "not replayable", "late" if an answer was, or "" if not requested
    replayed: str


async def beside(
    model: Model | None,
    folder: Path,
    seconds: float,
    priority: int,
    *,
    replay: bool = False,
) -> Drive:
    """Drive for some seconds at 1 kHz with a recorder; replay the recording if asked to.

    Raises
    ------
    ConfigError
        If the model cannot run here.
    """
    log = folder / "drive.mcap"
    config = _config(model, log, priority)
    async with Daemon(assemble_config(config, folder)) as daemon:
        await asyncio.sleep(SETTLE_S)
        statistics, first = daemon.scheduler.statistics, daemon.scheduler.tick
        before = statistics.tick.missed_ticks
        await asyncio.sleep(seconds)
        missed = statistics.tick.missed_ticks - before
        ticks, control = daemon.scheduler.tick - first, daemon.control
        state, reason = (
            control.state.name.lower(),
            control.reason if control.state else "",
        )
        events = [e.message for e in daemon.events.recent]
    replayed = ""
    if model is not None and replay:
        is_late = any("its outputs keep" in text for text in events)
        replayed = (
            "late"
            if is_late
            else await asyncio.to_thread(_replayed, model, log, folder)
        )
    process = model is not None and model.process
    return Drive(process, ticks, missed, state, reason, events, replayed)


def _config(model: Model | None, log: Path, priority: int) -> Config:
    blocks = []
    if model is not None:
        block: dict[str, Any] = {"name": "model", "fmu": str(model.path)}
        blocks.append(block | {"process": model.process, "start": dict(model.start)})
    return Config.model_validate(
        {
            "image": {"name": "auto"},
            "opcua": {"enabled": False},
            "metrics": {"enabled": False},
            "page": {"enabled": False},
            "recording": {"file": str(log)},
            "scheduler": {"realtime": {"priority": priority}},
            "blocks": blocks,
        }
    )


def _replayed(model: Model, log: Path, folder: Path) -> str:
    if not read_fmu(str(model.path), folder).stores_state:
        return "not replayable"
    with contextlib.redirect_stdout(io.StringIO()):
        code = main(["replay", str(log), "-o", str(folder / "again.mcap"), "--check"])
    return "equal" if code == EXIT_DONE else "differs"

"""A scenario through the whole daemon in virtual time: every frame from tick 0 on."""

from collections.abc import AsyncIterator, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Self

import numpy as np

from hilserver.config.root import Config
from hilserver.daemon.assembly import Assembly, assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.faults.scenario import Play
from hilserver.image import read_frames
from hilserver.logs import LogWriter, RecordedState, Segmented, open_writer
from hilserver.logs.provenance import make_run

BATCH_TICKS, RING_FRAMES = 1000, 2048


def quiet(config: Config) -> Config:
    """Return the same robot without anything that listens, connects or writes by itself."""
    return config.changed(
        scheduler={"backend": "virtual"},
        control={"source": "scenario"},
        image={"name": "auto", "ring_frames": RING_FRAMES},
        opcua={"enabled": False},
        metrics={"enabled": False},
        recording={"file": None},
        peers=(),
    )


def offline(assembly: Assembly) -> Assembly:
    """Return the assembly of the same robot, quiet."""
    return assemble_config(quiet(assembly.config), assembly.folder, assembly.patch)


class Simulation:
    """One run of a scenario by a quiet robot; an asynchronous context manager.

    ConfigError if the scenario names something that the robot does not have.
    """

    def __init__(self, assembly: Assembly, play: Play) -> None:
        self._daemon = Daemon(offline(assembly), play=play, paused=True)
        self.image = self._daemon.image
        self.table = self._daemon.table
        self.start = RecordedState(0, 0, self._daemon.core.snapshots.initial.copy())

    async def __aenter__(self) -> Self:
        await self._daemon.__aenter__()
        return self

    async def __aexit__(self, *error: object) -> None:
        await self._daemon.__aexit__(*error)

    @contextmanager
    def log(self, out: Path) -> Iterator[LogWriter]:
        """Open a log of all signals, which begins with the initial state for a replay."""
        run = make_run(self.image.description)
        with closing(open_writer(out, run, range(self.table.n_slots))) as writer:
            writer.add_state(self.start)
            yield writer

    async def frames(self, n_ticks: int) -> AsyncIterator[Segmented]:
        """Run so many ticks; yield their frames, stamped with simulated time."""
        scheduler = self._daemon.scheduler
        done = 0
        while done < n_ticks:
            n = min(BATCH_TICKS, n_ticks - done)
            number = self.image.head
            await scheduler.advance(n)
            frames = read_frames(self.image, number, n)
            frames.words[:, 1] = frames.ticks * scheduler.base_period_ns
            yield Segmented(frames, np.zeros(n, dtype=np.int64))
            done += n

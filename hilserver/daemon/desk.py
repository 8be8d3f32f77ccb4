"""What users start and stop by the name of a file: scenarios, recordings, patches.

Names are plain, files lie in the configured folders; existing ones are not overwritten.
"""

import asyncio
import contextlib
import re
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path, PurePath
from typing import Any

import structlog

from hilserver.config.loading import LIVE_BYTES
from hilserver.config.recording import RecordingConfig
from hilserver.core.leases import NOBODY
from hilserver.core.recalibration import Decisions
from hilserver.daemon.builder import Core
from hilserver.daemon.patches import Patches, file_of
from hilserver.errors import ControlRefused, FailedError, UserError, reason
from hilserver.faults import Play, load_scenario
from hilserver.faults.scenario import ScenarioPlayer
from hilserver.io.recorder.launch import running_recorder
from hilserver.tasks import SupervisedTask, Supervisor, first_of

SUFFIXES = (".mcap", ".csv")
VERSION = re.compile(r"v\d+")  # of `drive.v2`, whose point begins no suffix

_log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class _Playing:
    name: str
    start_tick: int
    end_tick: int
    owner: str


class Scenarios:
    """Plays scenarios of one folder, from the present tick on."""

    def __init__(self, folder: Path, stage: ScenarioPlayer, core: Core) -> None:
        self._folder = folder
        self._stage = stage
        self._core = core
        self._period_s = core.assembly.base_period_ns * 1e-9
        self._playing: _Playing | None = None

    async def start(self, name: str) -> None:
        """Start a scenario.

        ControlRefused if one is playing, or there is none of that name; ConfigError if the file has
        a mistake.
        """
        self._refuse_while_playing()
        path = file_of(self._folder, name, "scenario")
        scenario = await asyncio.to_thread(load_scenario, path, LIVE_BYTES)
        self._refuse_while_playing()  # another may have started while the file was read
        self._stage.check(Play(scenario, path))
        start = self._core.scheduler.tick + 1
        owner = self._core.gate.owner
        self._stage.play(scenario, start)
        end = start + round(scenario.length_s / self._period_s)
        self._playing = _Playing(path.name, start, end, owner)

    def _refuse_while_playing(self) -> None:
        if self.view() is not None:
            raise ControlRefused("a scenario is playing: call StopScenario first")

    def stop(self) -> None:
        """End the scenario and all faults, its own and others; set-points go to zero.

        ControlRefused if none is playing.
        """
        self._core.faults.expect_room()
        playing = self._playing
        self._playing = None
        if playing is None:
            raise ControlRefused("no scenario is playing")
        self._core.faults.reset()
        self._stage.stop()
        if self._core.gate.owner == "scenario":
            self._core.gate.take(playing.owner)

    def cut_short(self) -> None:
        """End the steps, so that none drives a robot that was stopped; faults continue."""
        # else another writer of source scenario keeps control
        drove = self._stage.drives
        self._stage.stop()
        if self._playing is not None:
            self._playing = replace(
                self._playing, end_tick=self._core.scheduler.tick - 1
            )
        if drove and self._core.gate.owner == "scenario":
            self._core.gate.take(NOBODY)

    def view(self) -> dict[str, Any] | None:
        """Return name, time and length of the scenario that plays, or None."""
        playing = self._playing
        tick = self._core.scheduler.tick
        if playing is None or not playing.start_tick - 1 <= tick <= playing.end_tick:
            return None
        seconds = round((tick - playing.start_tick + 1) * self._period_s, 1)
        length_s = (playing.end_tick - playing.start_tick) * self._period_s
        return {
            "name": playing.name,
            "seconds": seconds,
            "length_s": length_s,
        }


class Recordings:
    """Runs a recorder in addition to the daemon's, on request."""

    def __init__(
        self, folder: Path, config: RecordingConfig, image: str, tasks: Supervisor
    ) -> None:
        self._folder = folder
        self._config = config
        self._image = image
        self._tasks = tasks
        self._running: SupervisedTask | None = None
        self._asked = asyncio.Event()
        self._path = folder

    def start(self, name: str) -> None:
        """Start to record into a new file; the recorder attaches within seconds.

        ControlRefused if a recording runs, the suffix is not one of ours, or the file exists.
        """
        ending = PurePath(name).suffix[1:]
        has_suffix = ending[:1].isalpha() and not VERSION.fullmatch(ending)
        path = self._folder / (name if has_suffix else name + SUFFIXES[0])
        if self._is_running:
            raise ControlRefused(
                f"{self._path.name} is being recorded: call StopRecording first"
            )
        if path.suffix not in SUFFIXES:
            raise ControlRefused(f"'{name}' does not end in {' or '.join(SUFFIXES)}")
        if path.exists():
            raise ControlRefused(f"'{path.name}' exists; choose another name")
        self._path, self._asked = path, asyncio.Event()
        self._running = self._tasks.spawn(
            partial(self._run, path, self._asked), "recording"
        )

    @property
    def _is_running(self) -> bool:
        return self._running is not None and not self._running.done

    async def _run(self, path: Path, asked: asyncio.Event) -> None:
        """Record until asked to end.

        FailedError, which the supervisor makes known to all who watch, if it ends otherwise.
        """
        config = self._config.changed(file=path.name, rotate_mb=None)
        try:
            await asyncio.to_thread(self._folder.mkdir, parents=True, exist_ok=True)
            async with running_recorder(
                config, self._image, self._folder, self._tasks
            ) as end:
                await first_of(asked.wait(), end.by_itself.wait())
        except UserError as error:
            why = str(error)
        except OSError as error:
            why = f"{path.name}: cannot be recorded: {reason(error)}"
        else:
            why = end.why
        if why:  # on the page a file has no folder
            raise FailedError(why.replace(f"{self._folder}/", ""))

    def stop(self) -> None:
        """End the recording; its file is complete soon after.

        ControlRefused if nothing is being recorded.
        """
        if not self._is_running:
            raise ControlRefused("nothing is being recorded")
        self._asked.set()

    def view(self) -> dict[str, Any] | None:
        """Return name and size of the file that is being written, or None."""
        if not self._is_running:
            return None
        size = 0
        with contextlib.suppress(OSError):
            size = self._path.stat().st_size
        return {"name": self._path.name, "bytes": size}

    async def close(self) -> None:
        """End the recording and wait until its file is complete."""
        self._asked.set()
        if self._running is not None:
            await asyncio.wait({self._running.task})


@dataclass
class Desk:
    """What users start and stop by name; the OPC UA methods act on its parts."""

    scenarios: Scenarios
    recordings: Recordings
    patches: Patches
    recalibration: Decisions = field(default_factory=Decisions)

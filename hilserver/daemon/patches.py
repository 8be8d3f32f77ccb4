"""Model patches that are loaded and removed while the robot runs, each from one tick on."""

import asyncio
from pathlib import Path

import numpy as np

from hilserver.config.patch import Patch, load_patch
from hilserver.core.events import Event, EventKind
from hilserver.daemon.assembly import Assembly
from hilserver.daemon.builder import Core
from hilserver.errors import ControlRefused


class Patches:
    """Lays patches of one folder over the plant of a running core.

    Snapshots and recordings say which patch was at work: a recording goes on in a new segment with
    the state, parameters included, that the patch met.
    """

    def __init__(self, folder: Path, core: Core) -> None:
        self._folder, self._core = folder, core
        self._assembly = core.assembly
        self._edition = 0.0
        self._lock = asyncio.Lock()

    @property
    def loaded(self) -> str | None:
        """Name of the file whose patch is at work; None without one."""
        patch = self._assembly.patch
        return None if patch is None or patch.path is None else patch.path.name

    @property
    def notice(self) -> str | None:
        """What the page says beside the name: the patch may not fit this configuration."""
        patch = self._assembly.patch
        return None if patch is None else patch.notice(self._assembly.config.sha256)

    async def load(self, name: str) -> None:
        """Lay a patch over the plant, in place of the one before.

        Raises
        ------
        ControlRefused
            If there is none of that name.
        ConfigError
            If the file has a mistake or does not fit the configuration.
        """
        path = self._folder / name
        if not path.is_file():
            raise ControlRefused(f"there is no patch '{name}' in {self._folder}")
        patch = await asyncio.to_thread(load_patch, path)
        tick = await self._lay(patch)
        self._tell(200, f"model patch '{name}' is loaded from tick {tick} on")
        notice = patch.notice(self._assembly.config.sha256)
        if notice is not None:
            self._tell(400, notice)

    async def remove(self) -> None:
        """Go on with the plant of the configuration.

        Raises
        ------
        ControlRefused
            If no patch is loaded.
        """
        if self._assembly.patch is None:
            raise ControlRefused("no patch is loaded")
        tick = await self._lay(None)
        self._tell(200, f"the model patch is removed from tick {tick} on")

    async def _lay(self, patch: Patch | None) -> int:
        async with self._lock:
            new: Assembly = await asyncio.to_thread(self._assembly.patched, patch)
            numbers = {
                "p": new.composition.parameters.numbers,
                "fitted": new.composition.fitted,
                "edition": np.array([self._edition + 1.0]),
            }
            snapshots, image = self._core.snapshots, self._core.image
            tick = await snapshots.exchange(numbers, new.identity)
            self._assembly, self._edition = new, self._edition + 1.0
            image.tell(patch=new.provenance["patch"], identity=snapshots.identity)
            return tick

    def _tell(self, severity: int, text: str) -> None:
        self._core.events.publish(Event(EventKind.STATE, severity, "daemon", text))

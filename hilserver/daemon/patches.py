"""Model patches: sets of parameters in files, laid over the plant and saved while it runs."""

import asyncio
import os
from math import isnan
from pathlib import Path
from typing import Final

import yaml

from hilserver import __version__
from hilserver.config.patch import SCHEMA_2, Patch, load_patch
from hilserver.core.events import Event, EventKind
from hilserver.daemon.builder import Core
from hilserver.errors import ControlRefused
from hilserver.kernel.fitted import fitted_limits
from hilserver.parameters import check, named
from hilserver.plant.errors import PlantError
from hilserver.program.whole_file import sync_folder

MOST_FILES: Final = 100  # patches in the folder: saving them must not fill the disk


def file_of(folder: Path, name: str, kind: str) -> Path:
    """Return the file of a name, with or without its suffix; ControlRefused if there is none."""
    suffixes = ("",) if name.endswith((".yaml", ".yml")) else (".yaml", ".yml", "")
    for suffix in suffixes:
        path = folder / (name + suffix)
        if path.is_file():
            return path
    raise ControlRefused(f"there is no {kind} '{name}' in {folder}")


class Patches:
    """Lays patches of one folder over the plant of a running core, and saves what was tuned."""

    def __init__(self, folder: Path, core: Core) -> None:
        self._folder = folder
        self._core = core
        self._patch = core.assembly.patch
        # the file's values that are in force; a reload brings others
        self.from_file = core.assembly.from_file
        self._lock = asyncio.Lock()
        core.snapshots.restored.append(self._follow)

    @property
    def loaded(self) -> str | None:
        """Name of the file of the loaded patch, or None."""
        patch = self._patch
        if patch is None or patch.path is None:
            return None
        return patch.path.name

    @property
    def notice(self) -> str | None:
        """Notice next to the name on the page: the patch may not fit this configuration."""
        patch = self._patch
        return None if patch is None else patch.notice(self.config_sha256)

    @property
    def config_sha256(self) -> str:
        """Hash that patches of this robot carry: of the file, which is the input of a diagnosis."""
        return self.from_file.sha256

    async def load(self, name: str) -> None:
        """Lay a patch over the plant, in place of the loaded one.

        ControlRefused if there is none of that name; ConfigError if the file has a mistake or does
        not fit the configuration.
        """
        path = file_of(self._folder, name, "patch")
        patch = await asyncio.to_thread(load_patch, path)
        tick = await self._lay(patch)
        self._tell(200, f"model patch '{path.name}' is loaded from tick {tick} on")
        if (notice := patch.notice(self.config_sha256)) is not None:
            self._tell(400, notice)

    async def remove(self) -> None:
        """Set the parameters of the patch back to the configuration.

        ControlRefused if no patch is loaded.
        """
        if self._patch is None:
            raise ControlRefused("no patch is loaded")
        tick = await self._lay(None)
        self._tell(200, f"the model patch no longer applies from tick {tick} on")

    async def _lay(self, patch: Patch | None) -> int:
        parameters = self._core.parameters
        async with self._lock:
            configured = parameters.configured
            if self._patch is None:
                values = {}
            else:
                values = {n: configured[n] for n in self._patch.values}
            values |= {} if patch is None else self._checked(patch)
            fitted = fitted_limits(None if patch is None else patch.model)
            try:
                number = parameters.apply(values, fitted=fitted)
            except PlantError as error:
                key, _, rest = str(error).partition(": ")
                if patch is not None and (entry := patch.entry_at(key)) is not None:
                    raise patch.refusal(entry, rest) from None
                raise ControlRefused(str(error)) from None
            self._put(patch)
            return await parameters.taken(number)

    def _put(self, patch: Patch | None) -> None:
        """Store which patch is loaded, for snapshots and recordings started from now on."""
        self._patch = patch
        self._core.image.tell(patch=None if patch is None else patch.provenance)

    def _follow(self) -> None:
        """Forget a patch that is not part of the restored state."""
        patch = self._patch
        name = self.loaded
        if patch is not None and not self._core.parameters.hold(self._checked(patch)):
            self._put(None)
            self._tell(300, f"the model patch '{name}' is not part of the loaded state")

    def _checked(self, patch: Patch) -> dict[str, float]:
        table = self._core.parameters.table
        values = {}
        patch.applied(self._core.assembly.config.plant)
        for name, value in patch.values.items():
            try:
                full = named(name, table)
                values[full] = check(table[full], value)
            except PlantError as error:
                key, _, rest = str(error).partition(": ")
                raise patch.refusal(patch.entry_at(key) or name, rest) from None
        return values

    async def set_text(self, name: str, text: str) -> None:
        """Set a parameter by a number, a name of one, or null.

        ControlRefused if it cannot have that value.
        """
        try:
            value: object = None if text == "null" else float(text)
        except ValueError:
            value = text
        parameters = self._core.parameters
        try:
            number = parameters.apply(parameters.checked({name: value}))
        except PlantError as error:
            raise ControlRefused(str(error)) from None
        await parameters.taken(number)

    async def reset(self) -> None:
        """Go back to the configuration, without a patch."""
        parameters = self._core.parameters
        async with self._lock:
            values = {n: parameters.configured[n] for n in parameters.differing}
            tick = await parameters.taken(
                parameters.apply(values, fitted=fitted_limits())
            )
            self._put(None)
        self._tell(
            200, f"all parameters have their configured values from tick {tick} on"
        )

    async def save(self, name: str) -> None:
        """Write the parameters that differ from the configuration as a patch.

        ControlRefused if none differs, the file exists, or it cannot be written.
        """
        path = self._folder / f"{name.removesuffix('.yaml')}.yaml"
        parameters = self._core.parameters
        values = parameters.differing
        if not values:
            raise ControlRefused("no parameter differs from the configuration")
        saved = {
            n: {
                "value": None if isnan(v) else v,
                "unit": parameters.table[n].unit,
            }
            for n, v in values.items()
        }
        made_from = {
            "config_sha256": self.config_sha256,
            "version": __version__,
        }
        text = yaml.safe_dump(
            {
                "schema": SCHEMA_2,
                "made_from": made_from,
                "parameters": saved,
            },
            sort_keys=False,
            allow_unicode=True,
        )
        await asyncio.to_thread(_write, path, text)
        self._tell(200, f"{len(values)} parameters are saved as patch '{path.name}'")

    def _tell(self, severity: int, text: str) -> None:
        self._core.events.publish(Event(EventKind.STATE, severity, "daemon", text))


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    n_files = sum(1 for _ in path.parent.glob("*.yaml"))
    if n_files >= MOST_FILES:
        raise ControlRefused(
            f"there are {n_files} patches in {path.parent}; remove some first"
        )
    try:
        file = path.open("x", encoding="utf-8")
    except FileExistsError:
        raise ControlRefused(f"'{path.name}' exists; choose another name") from None
    except OSError as error:
        raise ControlRefused(f"{path}: cannot be written: {error.strerror}") from None
    try:
        with file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        sync_folder(path.parent)
    except OSError as error:
        path.unlink()  # half a patch is useless and would occupy the name
        raise ControlRefused(f"{path}: cannot be written: {error.strerror}") from None

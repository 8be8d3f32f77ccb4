"""What a daemon is built from: everything fixed before the first tick, and what identifies it.

Models of others are only described here: each robot starts and ends its own (`with_models`).
"""

import hashlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hilserver import __version__
from hilserver.body.engine import BodyEngine
from hilserver.body.parameters import BodyParameters
from hilserver.compiled import kernel_hash
from hilserver.config.loading import place
from hilserver.config.patch import Patch
from hilserver.config.root import Config, without_passwords
from hilserver.errors import ConfigError
from hilserver.kernel import BlockUse, Composition
from hilserver.kernel.composition import ForeignModel, Setting
from hilserver.plant.errors import PlantError
from hilserver.plant.packing import pack
from hilserver.plant.parameters import RobotParameters
from hilserver.scheduler import RealtimeSettings
from hilserver.scheduler.slices import Slice
from hilserver.signals import SignalTable


@dataclass(frozen=True)
class Assembly:
    """What a daemon is built from."""

    # in force: `from_file` with the changes of command-line options
    config: Config
    from_file: Config
    # the configuration file; relative paths in it are relative to its folder
    path: Path | None
    robot: RobotParameters
    table: SignalTable
    base_period_ns: int
    # compiled ones first, in the order in which they run in a tick
    slices: Sequence[Slice]
    composition: Composition
    configured: RobotParameters  # the plant of `config` alone
    # laid over the plant of `config`, which stays as it was read
    patch: Patch | None = None

    @property
    def folder(self) -> Path:
        """Folder that relative paths of the configuration start from."""
        if self.path is None:
            return Path.cwd()
        return self.path.resolve().parent

    @property
    def body(self) -> BodyParameters:
        """The robot's body as others describe it, whether or not the mechatronic model runs.

        ConfigError if it could not stand.
        """
        slice_s = self.robot.period_s
        # a description takes no steps, so none may be too long for its tyres
        section = self.config.mechatronic.changed(step_ms=slice_s)
        try:
            return section.body(self.robot, slice_s)
        except PlantError as error:
            key, _, why = str(error).partition(": ")
            where = place(self.path, key.split("."))
            raise ConfigError(where + why) from None

    @contextmanager
    def at(self, *location: str | int) -> Iterator[None]:
        """Add the place in the file to complaints about it."""
        try:
            yield
        except ConfigError as error:
            raise ConfigError(place(self.path, location) + str(error)) from None

    @property
    def identity(self) -> dict[str, str]:
        """What two runs must have in common for one to continue the other."""
        c = self.composition
        numbers = pack(self.configured).numbers.tobytes() + c.hall.tobytes()
        digest = hashlib.sha256(numbers)
        if c.body is not None:
            digest.update(c.body.identity)
        if c.observer is not None:
            digest.update(c.observer.source.encode() + c.observer.constants.tobytes())
        for block in c.blocks:
            wiring: tuple[object, ...] = (block.name, block.slice, dict(block.inputs))
            drives = [dict(block.drives)] if block.drives else ()
            wiring += (
                dict(block.parameters),
                *drives,
            )
            own = block.model
            if own is None:
                source = block.declaration.source.read_bytes()
            else:
                source = own.identity
            digest.update(repr(wiring).encode() + source)
        periods = {s.name: s.period_ticks for s in self.slices if s.compiled}
        return {
            "parameters": digest.hexdigest(),
            "base_period_ns": str(self.base_period_ns),
            "slices": repr(periods),
        }

    @property
    def provenance(self) -> dict[str, Any]:
        """What every recording states about the run that made it."""
        not_replayable = (
            {"not_replayable": self.not_replayable} if self.not_replayable else {}
        )
        return {
            "version": __version__,
            "kernels": kernel_hash(),
            "configuration": without_passwords(self.config),
            "config_sha256": self.config.sha256,
            "config_folder": str(self.folder),
            "patch": None if self.patch is None else self.patch.provenance,
            "seed": self.config.plant.seed,
            "base_period_ns": self.base_period_ns,
            "parameters": list(self.composition.settings),
        } | not_replayable

    @property
    def not_replayable(self) -> list[str]:
        """Why a recording of this run cannot be replayed; empty if it can."""
        return [model.not_replayable for model in self._models if model.not_replayable]

    @property
    def remarks(self) -> list[str]:
        """What the user of models of others should know."""
        return [model.remark for model in self._models if model.remark]

    @property
    def _models(self) -> list[ForeignModel]:
        return [b.model for b in self.composition.blocks if b.model is not None]


def with_models(
    assembly: Assembly, plant: RealtimeSettings, *, waits: bool
) -> Assembly:
    """Return an assembly with models of its own, the mechatronic one and FMUs.

    ConfigError if an FMU does not start.

    Parameters
    ----------
    plant : RealtimeSettings
        Settings of the plant's thread; models in processes of their own run one below it.
    waits : bool
        Whether time waits for models in processes of their own: simulated time does.
    """
    composition = assembly.composition
    body = None if composition.body is None else BodyEngine(composition.body.body)
    with ExitStack() as begun:
        blocks = []
        for index, block in enumerate(composition.blocks):
            with assembly.at("blocks", index, "fmu"):
                blocks.append(_started(block, assembly, plant, waits=waits))
            foreign = blocks[-1].foreign
            if foreign is not None:
                begun.callback(foreign.close)
        begun.pop_all()
    return replace(assembly, composition=replace(composition, body=body, blocks=blocks))


def end_models(assembly: Assembly) -> None:
    """End the FMUs of an assembly; nothing is paced any more."""
    for block in assembly.composition.blocks:
        if block.foreign is not None:
            block.foreign.close()


def _started(
    block: BlockUse, assembly: Assembly, plant: RealtimeSettings, *, waits: bool
) -> BlockUse:
    if block.model is None:
        return block
    period_s = assembly.composition.periods_s[block.slice]
    base_period_s = assembly.base_period_ns * 1e-9
    priority = max(plant.priority - 1, 0)
    setting = Setting(period_s, base_period_s, waits, priority, plant.cpu)
    return replace(block, foreign=block.model.start(block.name, setting))

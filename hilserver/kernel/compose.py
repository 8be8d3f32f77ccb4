"""Writes, compiles and caches the step of one configuration.

The parts of a slice are called one after the other, each with its own pieces of the arena. The
source is generated, because a chain of compiled calls cannot be built from a list at run time; it
is small, and it is kept beside the cached machine code for whoever wants to read it.
"""

import importlib.util
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from hilserver.compiled.cache import cache_dir, hash_of
from hilserver.image import ProcessImage
from hilserver.image.layout import Region
from hilserver.kernel.modifier_layout import REGIONS_FIXED, REGIONS_LIVE
from hilserver.plant import layout as robot
from hilserver.plant.blocks import BlockDeclaration
from hilserver.scheduler.step import FAULT, LATCH, PUBLISH, StepFunction
from hilserver.signals import SignalTable

_ROBOT_CALLS = {
    "robot": "robot_step({p}, {x}, {u}, {y}, {q})",
    "imu": "imu_step({p}, {x}, {u}, {y}, {q})",
    "battery": "battery_step({p}, {x}, {u}, {y}, {q})",
    "tof": "tof_step({p}, {x}, {u}, {y}, {q}, {hall})",
    "nav": "nav_step({p}, {x}, {u}, {y}, {q})",
}

_HEAD = '''"""Generated: the step of one configuration. Read it, do not edit it."""

from math import nan

from hilserver.compiled import kernel
from hilserver.kernel.fitted import flag_unfitted
from hilserver.kernel.phases import enter_safe, latch, publish, quality
from hilserver.plant.robot import robot_step
from hilserver.plant.sensors import battery_step, imu_step, nav_step, tof_step
from hilserver.scheduler.step import STEP_SIGNATURE


@kernel(STEP_SIGNATURE)
def step(phase, tick, planned_ns, values, words):
'''


@dataclass(frozen=True)
class Part:
    """One of the robot's own parts and the slice it runs in: robot, imu, battery, tof or nav."""

    name: str
    slice: str


@dataclass(frozen=True)
class BlockUse:
    """A user's block, put into a slice and wired.

    Attributes
    ----------
    inputs : mapping of str
        Signal for each declared input.
    parameters : mapping of float
        Values that replace the declared defaults.
    """

    name: str
    declaration: BlockDeclaration
    slice: str
    inputs: Mapping[str, str]
    parameters: Mapping[str, float] = field(default_factory=dict)

    def output_signal(self, output: str) -> str:
        """Return the name of the signal of an output."""
        return f"{self.name}.{output}"

    @property
    def regions(self) -> dict[str, int]:
        """Lengths [words] of what the block remembers between its runs."""
        d = self.declaration
        return {
            f"{self.name}.u": len(d.inputs),
            f"{self.name}.y": len(d.outputs),
            f"{self.name}.x": len(d.state),
        }


@dataclass(frozen=True)
class Composition:
    """What runs: the robot's parts and the blocks, by slice.

    Attributes
    ----------
    slices : sequence of str
        Compiled slices in the order in which they run in a tick.
    periods_s : mapping of float
        Period of each slice [s].
    hall : ndarray of float64
        Line segments for the range finders, as `tof_step` takes them, flattened.
    fitted : ndarray of float64 or None
        Ranges in which the terms of a patch were fitted; None without a patch.
    """

    table: SignalTable
    slices: Sequence[str]
    periods_s: Mapping[str, float]
    parts: Sequence[Part]
    blocks: Sequence[BlockUse]
    parameters: NDArray[np.float64]
    state: NDArray[np.float64]
    hall: NDArray[np.float64]
    fitted: NDArray[np.float64] | None = None

    @property
    def live_regions(self) -> dict[str, int]:
        """Regions of the arena that a snapshot holds, with their lengths in words."""
        regions = {"x": robot.N_X} | REGIONS_LIVE
        for block in self.blocks:
            regions |= block.regions
        return regions

    @property
    def fixed_regions(self) -> dict[str, int]:
        """Regions of the arena that a run does not change."""
        regions = {"p": robot.N_P, "hall": self.hall.size} | REGIONS_FIXED
        if self.fitted is not None:
            regions["fitted"] = self.fitted.size
        for block in self.blocks:
            regions[f"{block.name}.p"] = len(block.declaration.parameters)
        return regions


def compose(composition: Composition, image: ProcessImage) -> StepFunction:
    """Fill the arena, generate the step, compile it (or take it from the cache).

    Returns
    -------
    StepFunction
        Ready to be handed to the scheduler.
    """
    _fill(composition, image)
    source = _source(composition, image)
    return cast("StepFunction", _module(source, composition.blocks).step)


def watch_communication(image: ProcessImage, limit_ticks: int) -> None:
    """Let the plant go to the safe state when the event loop is silent for `limit_ticks`."""
    image.control.heartbeat_age = 0
    image.control.heartbeat_limit = limit_ticks


def limit_silence(image: ProcessImage, limit_ticks: int) -> None:
    """Let the set-points become zero when none has come for `limit_ticks`; 0: never."""
    image.control.command_limit = limit_ticks


def _fill(composition: Composition, image: ProcessImage) -> None:
    regions = image.layout.regions
    image.control.modifiers = regions["modifiers"].base
    image.control.mail_base = regions["modifier_mail"].base
    image.control.setpoint_slots = robot.U_MODE

    def put(name: str, numbers: Any) -> None:
        region = regions[name]
        image.values[region.base : region.base + region.length] = numbers

    put("p", composition.parameters)
    put("x", composition.state)
    put("hall", composition.hall.ravel())
    if composition.fitted is not None:
        put("fitted", composition.fitted)
    for block in composition.blocks:
        values = {**block.declaration.parameters, **block.parameters}
        put(f"{block.name}.p", [values[name] for name in block.declaration.parameters])
        put(f"{block.name}.x", list(block.declaration.state.values()))


def _piece(region: Region) -> str:
    return f"[{region.base} : {region.base + region.length}]"


def _source(composition: Composition, image: ProcessImage) -> str:
    regions, table = image.layout.regions, composition.table
    frame, status = regions["frame"].base, regions["status"].base
    first_output = frame + robot.N_U
    arguments = {
        "p": f"values{_piece(regions['p'])}",
        "x": f"values{_piece(regions['x'])}",
        "u": f"values[{frame} : {first_output}]",
        "y": f"values[{first_output} : {first_output + robot.N_Y}]",
        "q": f"words[{status + robot.N_U} : {status + robot.N_U + robot.N_Y}]",
        "hall": f"values{_piece(regions['hall'])}",
    }
    command, enable = table.slot("internal.command"), table.slot("drive.enable")
    sim, state = table.slot("sim.tick"), table.slot("internal.state")
    lines = [
        f"if phase == {LATCH}:",
        f"    return latch(tick, {command}, {enable}, {state}, values, words)",
        f"if phase == {PUBLISH}:",
        *_flags(composition, regions),
        "    return publish("
        f"tick, planned_ns, {command}, {robot.N_U}, {robot.N_Y}, {sim}, values, words)",
        f"if phase == {FAULT}:",
        f"    enter_safe(tick, {command}, values, words)",
        "    return 0",
    ]
    for index, name in enumerate(composition.slices):
        lines.append(f"if phase == {index}:  # {name}, {composition.periods_s[name]:g} s")
        calls = [
            _ROBOT_CALLS[p.name].format(**arguments) for p in composition.parts if p.slice == name
        ]
        for number, block in enumerate(composition.blocks):
            if block.slice == name:
                calls += _block_calls(number, block, composition, image)
        lines += [f"    {call}" for call in ("fault = 0", *calls, "return fault")]
    lines.append("return 0")
    return _HEAD + "".join(f"    {line}\n" for line in lines)


def _flags(composition: Composition, regions: Mapping[str, Region]) -> list[str]:
    if composition.fitted is None:
        return []
    return [f"    flag_unfitted({regions['fitted'].base}, values, words)"]


def _block_calls(
    number: int, block: BlockUse, composition: Composition, image: ProcessImage
) -> list[str]:
    regions, table = image.layout.regions, composition.table
    frame, status = regions["frame"].base, regions["status"].base
    u, y = regions[f"{block.name}.u"], regions[f"{block.name}.y"]
    x, p = regions[f"{block.name}.x"], regions[f"{block.name}.p"]
    declared = block.declaration
    calls = [
        f"values[{u.base + i}] = values[{frame + table.slot(block.inputs[name])}]"
        for i, name in enumerate(declared.inputs)
    ]
    calls += [
        "try:",
        f"    block_{number}({composition.periods_s[block.slice]!r}, values{_piece(u)},"
        f" values{_piece(y)}, values{_piece(x)}, values{_piece(p)})",
        "except Exception:",
        f"    fault = {number + 1}",
        *(f"    values[{y.base + i}] = nan" for i in range(y.length)),
    ]
    for i, output in enumerate(declared.outputs):
        slot = table.slot(block.output_signal(output.name))
        calls.append(f"values[{frame + slot}] = values[{y.base + i}]")
        calls.append(f"words[{status + slot}] = quality(values[{y.base + i}])")
    return calls


def _identity(declaration: BlockDeclaration) -> str:
    """Return what tells two functions of one file apart, as the source of the step does not."""
    function = declaration.source_function
    enclosed = [cell.cell_contents for cell in function.__closure__ or ()]
    return f"{declaration.name}:{function.__code__.co_firstlineno}:{enclosed!r}"


def _module(source: str, blocks: Sequence[BlockUse]) -> ModuleType:
    """Import the generated source from the cache folder, so that numba can cache its code."""
    own = [block.declaration.source for block in blocks]
    name = f"step_{hash_of(own, source, *(_identity(block.declaration) for block in blocks))}"
    path = cache_dir() / f"{name}.py"
    if not path.exists():
        partial = path.with_suffix(f".{id(source)}.part")
        partial.write_text(source, encoding="utf-8")
        partial.replace(path)
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"cannot import {path}")
    module = importlib.util.module_from_spec(spec)
    for number, block in enumerate(blocks):
        setattr(module, f"block_{number}", block.declaration.function)
    sys.modules[name] = module  # numba looks the module up when it loads code from the cache
    spec.loader.exec_module(module)
    return module

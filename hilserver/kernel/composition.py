"""What runs in a step: the robot's own parts and the user's blocks, by slice."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from hilserver.body.engine import BodyEngine
from hilserver.body.layout import Addresses, Constants
from hilserver.image import changes
from hilserver.image.layout import padded
from hilserver.kernel.fitted import N_LIMITS, fitted_limits
from hilserver.kernel.modifier_layout import REGIONS_FIXED, REGIONS_LIVE
from hilserver.observer.layout import N_FILTER, FilterFigures
from hilserver.plant import layout as robot
from hilserver.plant.blocks import BlockDeclaration
from hilserver.signals import SignalTable


@dataclass(frozen=True)
class RobotPart:
    """One of the robot's own parts (robot, imu, battery, shield, tof, nav) and its slice.

    With `of_body` it is a part of the mechatronic model: body, body_wheels, imu, tof, nav.
    """

    name: str
    slice: str
    of_body: bool = False


class Setting(NamedTuple):
    """What a foreign model runs in: periods of its slice and of a tick, virtual time or not."""

    period_s: float
    base_period_s: float
    waits: bool
    priority: int = 0  # SCHED_FIFO of a process beside the plant; 0: an ordinary one
    plant_core: int | None = None  # core that this process leaves to the plant


class News(NamedTuple):
    """What happened to a foreign model; a fault leads to the safe state."""

    text: str
    is_fault: bool


class Foreign(Protocol):
    """A foreign model that was started: compiled functions that call it, and what they need."""

    # ``(tick, dt_s, u, y, x, p, a) -> int``, a fault number or 0
    step: Callable[..., int]
    # ``(u, y, x, p, a)``: write the state to `x` before a snapshot; continue from `x` after one
    keep: Callable[..., None]
    adopt: Callable[..., None]
    # `a` at the start, of this process; must outlive the step
    addresses: NDArray[np.int64]
    initial: NDArray[np.float64]  # `x` at the start
    key: str  # hash of the functions' sources

    def look(self, a: NDArray[np.int64]) -> Sequence[News]:
        """Return what happened since the last call; `a` as the step has it."""

    def close(self) -> None:
        """End it."""


class ForeignModel(Protocol):
    """A model from outside, for example an FMU; every robot starts its own.

    Attributes
    ----------
    identity : bytes
        Equal in two runs if one can continue the other.
    not_replayable : str
        Why a recording with it cannot be replayed; empty if it can.
    remark : str
        What its user should know; may be empty.
    """

    @property
    def identity(self) -> bytes: ...  # noqa: D102

    @property
    def not_replayable(self) -> str: ...  # noqa: D102

    @property
    def remark(self) -> str: ...  # noqa: D102

    def start(self, name: str, setting: Setting) -> Foreign:
        """Start it."""


@dataclass(frozen=True)
class BlockUse:
    """A user's block, assigned to a slice and wired."""

    name: str
    declaration: BlockDeclaration
    slice: str
    inputs: Mapping[str, str]  # signal for each declared input
    # values that replace the declared defaults
    parameters: Mapping[str, float] = field(default_factory=dict)
    # model behind the block, if it is not a user's function
    model: ForeignModel | None = None
    foreign: Foreign | None = None  # that model, started for this robot
    # signal that an output commands; a block with any is a controller
    drives: Mapping[str, str] = field(default_factory=dict)

    def output_signal(self, output: str) -> str:
        """Return the name of the signal of an output."""
        return f"{self.name}.{output}"

    @property
    def regions(self) -> dict[str, int]:
        """Lengths [words] of the regions that the block keeps between its runs."""
        d = self.declaration
        return {
            f"{self.name}.u": len(d.inputs),
            f"{self.name}.y": len(d.outputs),
            f"{self.name}.x": len(d.state)
            if self.foreign is None
            else self.foreign.initial.size,
        }

    @property
    def values(self) -> list[float]:
        """Its parameters in the order of the declaration."""
        given = {**self.declaration.parameters, **self.parameters}
        return [given[name] for name in self.declaration.parameters]


@dataclass(frozen=True)
class ObserverUse:
    """The observer, assigned to a slice."""

    source: str  # simulated or measured
    # `c` of its kernels, computed at the parameters `base`
    constants: NDArray[np.float64]
    base: robot.Parameters
    nav_ticks: int  # period of the simulated navigation's slice
    imu_ticks: int

    def packed(self, now: robot.Parameters) -> NDArray[np.float64]:
        """Return the constants with their varied parameter sets moved to the parameters `now`."""
        c, n, base = self.constants.copy(), robot.Parameters.n_words, self.base.numbers
        for first in range(FilterFigures.n_words, c.size, n):
            moved = c[first : first + n]
            by = np.where(moved == base, 0.0, moved) - np.where(
                moved == base, 0.0, base
            )
            c[first : first + n] = now.numbers + by
        return c


@dataclass(frozen=True)
class Composition:
    """The robot's parts and the blocks, by slice."""

    table: SignalTable
    slices: Sequence[str]  # compiled slices in the order in which they run in a tick
    periods_s: Mapping[str, float]  # period of each slice [s]
    parts: Sequence[RobotPart]
    blocks: Sequence[BlockUse]
    parameters: robot.Parameters
    state: robot.State
    # line segments for the range finders, as `tof_step` takes them, flattened
    hall: NDArray[np.float64]
    # ranges in which the terms of a patch were fitted, see `fitted_limits`
    fitted: NDArray[np.float64] = field(default_factory=fitted_limits)
    body: BodyEngine | None = (
        None  # the mechatronic model; its addresses must outlive the step
    )
    observer: ObserverUse | None = None  # the filter that estimates where the robot is
    # value of every parameter by its name, see `hilserver.parameters`; NaN is null
    settings: Mapping[str, float] = field(default_factory=dict)

    @property
    def parameter_regions(self) -> dict[str, int]:
        """Regions that a change of parameters replaces as one piece, with their lengths."""
        own = {"p": robot.Parameters.n_words, "fitted": N_LIMITS, "edition": 1}
        own["parameters"] = len(self.settings)
        if self.observer is not None:
            own["observer_p"] = self.observer.constants.size
        return own | {f"{b.name}.p": len(b.declaration.parameters) for b in self.blocks}

    def packed(self, edition: int = 0) -> NDArray[np.float64]:
        """Return this piece: all numbers of the parameters that the step reads."""
        numbers: dict[str, Any] = {
            "p": self.parameters.numbers,
            "fitted": self.fitted,
            "edition": edition,
            "parameters": list(self.settings.values()),
        }
        if self.observer is not None:
            numbers["observer_p"] = self.observer.packed(self.parameters)
        numbers |= {f"{block.name}.p": block.values for block in self.blocks}
        piece = np.zeros(sum(map(padded, self.parameter_regions.values())))
        begin = 0
        for name, length in self.parameter_regions.items():
            piece[begin : begin + length] = numbers[name]
            begin += padded(length)
        return piece

    @property
    def live_regions(self) -> dict[str, int]:
        """Regions of the arena that a snapshot holds, with their lengths in words.

        They include the parameters, so a recording in which a patch was loaded can be replayed.
        """
        regions = {"x": robot.State.n_words, **self.parameter_regions} | REGIONS_LIVE
        if self.body is not None:
            regions["body"] = self.body.initial.size
        if self.observer is not None:
            regions["observer"] = N_FILTER
        for block in self.blocks:
            regions |= block.regions
        return regions

    @property
    def fixed_regions(self) -> dict[str, int]:
        """Regions of the arena that are not part of a snapshot."""
        regions = {"hall": self.hall.size} | REGIONS_FIXED
        packed = sum(map(padded, self.parameter_regions.values()))
        regions[changes.REGION] = changes.words_needed(packed)
        if self.body is not None:
            regions |= {"body_p": Constants.n_words, "body_a": Addresses.n_words}
        for block in self.blocks:
            if block.foreign is not None:
                regions[f"{block.name}.a"] = block.foreign.addresses.size
        return regions

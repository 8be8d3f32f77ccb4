"""The parameters of a running robot; every change of one, from any door, is made here.

A change is checked and packed once and handed to the step, which takes it as a whole at one
tick. A change that does not fit is refused with a sentence, and nothing changes.
"""

import asyncio
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from math import isnan
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilserver.core.events import Event, EventBus, EventKind
from hilserver.core.refusal import Refusal
from hilserver.core.snapshot import SnapshotStore
from hilserver.errors import ControlRefused
from hilserver.image import ProcessImage
from hilserver.image.changes import NOW, Changes
from hilserver.kernel import BlockUse, Composition
from hilserver.parameters import (
    Parameter,
    check,
    geometric_gain,
    named,
    read,
    table_of,
    with_values,
)
from hilserver.parameters.table import BLOCK, GAIN, gains
from hilserver.plant.errors import PlantError
from hilserver.plant.packing import initial_state, pack
from hilserver.plant.parameters import RobotParameters

_TAKEN_WITHIN_S: Final = 2.0
_FULL: Final = "the plant has not applied the last changes yet; try again"
_OF_THE_BODY: Final = ("plant.wheel_radius_m", "plant.wheelbase_m", "plant.track_m")
_OF_THE_DRIVES: Final = (
    "plant.process.gain",
    "plant.process.t1_s",
    "plant.process.t2_s",
    "terms.process_gain",
    "terms.time_constant",
)
"""Parameters built into the mechatronic model; the latter only if torque drives it."""


@dataclass(frozen=True)
class Start:
    """What a run starts with."""

    robot: RobotParameters  # the plant of the first tick
    configured: RobotParameters  # of the configuration alone, without a patch
    composition: Composition  # own blocks, and what is packed beside them

    @property
    def table(self) -> dict[str, Parameter]:
        """Every parameter of this robot; those built into its body need a restart."""
        composition = self.composition
        table = table_of(
            (block.name, block.declaration) for block in composition.blocks
        )
        table[GAIN] = replace(table[GAIN], names=gains(geometric_gain(self.configured)))
        if composition.body is None:
            return table
        built_in = _OF_THE_BODY + (_OF_THE_DRIVES if self.robot.body_wheels else ())
        return table | {
            n: replace(table[n], when="restart", jumps="") for n in built_in
        }

    @property
    def values(self) -> dict[str, float]:
        """Values of all parameters by the configuration."""
        own = {
            n: v for n, v in self.composition.settings.items() if n.startswith(BLOCK)
        }
        return {**self.composition.settings, **read(self.configured), **own}


class Refused(NamedTuple):
    """Why a parameter keeps its value: a reason as for other inputs, and a sentence."""

    reason: Refusal
    text: str


class LiveParameters:
    """Parameters in force, or on their way into the step; for the thread of the event loop only.

    Everything is by name, and NaN is null: `table` describes the parameters, `values` are those in
    force, `configured` those of the configuration. A scheduled change is packed `ahead_ticks`
    before its tick.
    """

    def __init__(
        self,
        start: Start,
        image: ProcessImage,
        snapshots: SnapshotStore,
        events: EventBus,
        ahead_ticks: int,
    ) -> None:
        self.table = start.table
        self.configured = start.values
        self.values: Mapping[str, float] = dict(start.composition.settings)
        self._robot = start.robot
        self._composition = start.composition
        self._geometric = geometric_gain(start.configured)
        self._image = image
        self._snapshots = snapshots
        self._events = events
        self._changes = Changes(image)
        self._number = 0
        self._timed: deque[tuple[int, Mapping[str, float]]] = deque()
        self._ahead = ahead_ticks
        snapshots.restored.append(self.follow)

    # --- changes ----------------------------------------------------------------------------------

    def write(self, source: str, values: Mapping[str, object]) -> dict[str, Refused]:
        """Check values, hand the valid ones to the next tick together; return refusals by name."""
        sound: dict[str, float] = {}
        refused: dict[str, Refused] = {}
        for name, value in values.items():
            try:
                sound |= self.checked({name: value})
            except PlantError as error:
                known = self.table.get(name)
                is_fixed = known is not None and known.when == "restart"
                code = Refusal.NOT_WRITABLE if is_fixed else Refusal.OUT_OF_RANGE
                refused[name] = Refused(code, str(error))
        if sound:
            try:
                self.apply(sound)
            except (PlantError, ControlRefused) as error:
                is_full = isinstance(error, ControlRefused)
                reason = Refusal.QUEUE_FULL if is_full else Refusal.OUT_OF_RANGE
                refused = {
                    name: refused.get(name, Refused(reason, str(error)))
                    for name in values
                }
        for name, (_, why) in refused.items():
            text = f"{source}: parameters.{name:.100} = {values[name]!r:.60} refused: {why}"
            self._events.publish(Event(EventKind.SETPOINT_REFUSED, 400, source, text))
        return refused

    def checked(self, values: Mapping[str, object]) -> dict[str, float]:
        """Return values by their full names, each checked by itself.

        PlantError if there is no such parameter, or it cannot have the value.
        """
        full = {named(name, self.table): value for name, value in values.items()}
        return {name: check(self.table[name], value) for name, value in full.items()}

    def try_out(
        self, values: Mapping[str, float]
    ) -> tuple[RobotParameters, Composition]:
        """Return what would run with these values, each checked before; nothing changes.

        PlantError if they do not fit the others.
        """
        own = {n: v for n, v in values.items() if n.startswith(BLOCK)}
        plant = {n: v for n, v in values.items() if n not in own}
        if plant:
            robot = with_values(self._robot, plant, self._geometric)
        else:
            robot = self._robot
        blocks = [_with_own(block, own) for block in self._composition.blocks]
        composition = replace(
            self._composition,
            parameters=pack(robot),
            blocks=blocks,
            settings={**self.values, **values},
        )
        return robot, composition

    def apply(
        self,
        values: Mapping[str, float],
        *,
        fitted: NDArray[np.float64] | None = None,
        due: int = NOW,
    ) -> int:
        """Hand checked values, by their full names, to the plant; return the change's number.

        PlantError if they do not fit the others; ControlRefused if the plant takes no more changes.

        Parameters
        ----------
        fitted : ndarray of float64, optional
            Ranges of a patch, see `kernel.fitted`.
        """
        if self._snapshots.is_restoring:
            raise ControlRefused("a snapshot is being loaded; try again")
        robot, composition = self.try_out(values)
        if fitted is not None:
            composition = replace(composition, fitted=fitted)
        number = max(self._number, self._edition) + 1
        packed = composition.packed(number)
        if not self._changes.post(number, packed, due):
            raise ControlRefused(_FULL)
        self._robot = robot
        self._composition = composition
        self._number = number
        self.values = composition.settings
        self._keep_for_reset(packed)
        return number

    def reset(self) -> int:
        """Go back to the values of the configuration.

        ControlRefused if the plant takes no more changes.
        """
        return self.apply({n: self.configured[n] for n in self.differing})

    async def taken(self, number: int) -> int:
        """Wait until a change takes effect; return its first tick.

        ControlRefused if the plant does not answer.
        """
        deadline = asyncio.get_running_loop().time() + _TAKEN_WITHIN_S
        while (tick := self._changes.tick_of(number)) is None:
            if asyncio.get_running_loop().time() > deadline:
                raise ControlRefused(
                    f"the plant did not answer within {_TAKEN_WITHIN_S:g} s"
                )
            await asyncio.sleep(0.001)
        return tick

    @property
    def differing(self) -> dict[str, float]:
        """Parameters that differ from the configuration, with their present values."""
        return {
            n: v for n, v in self.values.items() if not _same(v, self.configured[n])
        }

    def hold(self, values: Mapping[str, float]) -> bool:
        """Return whether all these values, by their full names, are in force."""
        return all(_same(self.values[name], value) for name, value in values.items())

    # --- at a time --------------------------------------------------------------------------------

    def schedule(
        self, changes: Iterable[tuple[int, Mapping[str, float]]] = (), tick: int = 0
    ) -> None:
        """Schedule checked values for ascending ticks, in place of earlier schedules."""
        self._timed = deque(changes)
        self.look_ahead(tick)

    def look_ahead(self, tick: int) -> None:
        """Hand over what is scheduled for the next ticks; called by the publish slice.

        No further ahead: a packed change would undo what another door changes before its tick.
        """
        while (
            self._timed
            and self._timed[0][0] < tick + self._ahead
            and self._changes.room
        ):
            due, values = self._timed.popleft()
            try:
                self.apply(values, due=due)
            except (PlantError, ControlRefused) as error:
                text = f"scenario: parameters in tick {due} refused: {error}"
                self._events.publish(
                    Event(EventKind.SETPOINT_REFUSED, 400, "scenario", text)
                )

    # --- states that come and go ------------------------------------------------------------------

    @property
    def _edition(self) -> int:
        return int(self._image.region("edition")[0][0])

    def follow(self) -> None:
        """Take over the values of a state that was restored."""
        numbers = self._image.region("parameters")[0].tolist()
        held = dict(zip(self.values, numbers, strict=True))
        changed = {n: v for n, v in held.items() if not _same(v, self.values[n])}
        fitted = self._image.region("fitted")[0].copy()
        try:
            robot, composition = self.try_out(changed)
            composition = replace(composition, fitted=fitted)
        except PlantError as error:
            text = f"the parameters of the loaded state are not valid: {error}"
            self._events.publish(Event(EventKind.STATE, 500, "parameters", text))
            return
        self._robot = robot
        self._composition = composition
        self.values = held
        self._keep_for_reset(composition.packed(self._edition))

    def _keep_for_reset(self, packed: NDArray[np.float64]) -> None:
        """Let a Reset go back to the start with the present parameters."""
        live = self._image.control.live_base
        first = self._image.control.parameters_base - live
        initial = self._snapshots.initial
        initial[first : first + packed.size] = packed.view(np.int64)
        region = self._image.layout.regions["x"]
        first = region.base - live
        state = initial_state(self._robot)
        initial[first : first + region.length] = state.numbers.view(np.int64)


def _with_own(block: BlockUse, values: Mapping[str, float]) -> BlockUse:
    own = f"{BLOCK}{block.name}."
    mine = {n.removeprefix(own): v for n, v in values.items() if n.startswith(own)}
    return replace(block, parameters={**block.parameters, **mine}) if mine else block


def _same(a: float, b: float) -> bool:
    return a == b or (isnan(a) and isnan(b))

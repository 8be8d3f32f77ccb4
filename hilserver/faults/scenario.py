"""Timed scenarios: what is written when, and which faults act from when to when.

::

    scenario: the gyro fails in a curve
    seed: 7
    steps:
      - {at_s: 0.0, write: {control.mode: 1, twist.linear_m_s: 0.3}}
      - {at_s: 2.0, write: {twist.angular_rad_s: 0.5}}
      - {at_s: 3.0, set: {terms.rotation_gain: -0.3}}
    faults:
      - {fault: bias, signal: imu.gyro_z_rad_s, offset: 0.2, from_s: 3.0, until_s: 5.0}

Times count from the start of the simulation; everything acts at the start of its tick.
"""

from collections.abc import Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple, Self

from pydantic import ConfigDict, Field, model_validator

from hilserver.config.loading import MAX_BYTES, load, place, placed
from hilserver.config.section import Section
from hilserver.core.inputs import InputGate
from hilserver.core.parameters import LiveParameters
from hilserver.core.refusal import Refusal, check_value
from hilserver.errors import ConfigError, ControlRefused, no_signal
from hilserver.faults.book import Faults
from hilserver.faults.model import Fault, Seconds
from hilserver.image import ProcessImage, Row
from hilserver.signals import SignalTable

MAX_STEPS = 4000
AFTER_S = 1.0  # how long a scenario runs on after its last step or fault


class Step(Section):
    """Values that are written at one time."""

    at_s: Seconds = Field(description="this long after the start [s]")
    write: dict[str, bool | float | list[float]] = Field(
        {}, description="signal: value", max_length=100
    )
    set_: dict[str, bool | float | str | None] = Field(
        {},
        alias="set",
        description="parameter: value, as in config.yaml",
        max_length=100,
    )

    model_config = ConfigDict(populate_by_name=True)

    @model_validator(mode="after")
    def _does_something(self) -> Self:
        if not self.write and not self.set_:
            raise ValueError("a step needs 'write' or 'set'")
        return self


class Scenario(Section):
    """A timed scenario."""

    scenario: str = Field("", max_length=200, description="description, for people")
    seed: int = Field(
        0, ge=0, lt=2**31, description="for faults without a seed of their own"
    )
    steps: tuple[Step, ...] = Field(
        (), max_length=MAX_STEPS, description="what is written"
    )
    faults: tuple[Fault, ...] = Field((), max_length=200, description="what is wrong")

    @property
    def length_s(self) -> float:
        """Time of the last thing that happens [s]."""
        ends = [step.at_s for step in self.steps]
        ends += [f.from_s if f.end_s is None else f.end_s for f in self.faults]
        return max(ends, default=0.0)

    @property
    def lasts_s(self) -> float:
        """How long a simulation of it runs [s]."""
        return self.length_s + AFTER_S

    @property
    def seeded_faults(self) -> list[Fault]:
        """Faults, each with a seed."""
        return [
            fault if fault.seed is not None else fault.changed(seed=self.seed)
            for fault in self.faults
        ]


class Play(NamedTuple):
    """A scenario and the file it came from."""

    scenario: Scenario
    path: Path | None = None


def load_scenario(path: Path, most_bytes: int = MAX_BYTES) -> Scenario:
    """Return the scenario of a file, or ConfigError.

    Its signals are looked up by `ScenarioPlayer.check`.
    """
    return load(path, Scenario, most_bytes)


class ScenarioPlayer:
    """Plays scenarios on a daemon's parts."""

    def __init__(
        self,
        table: SignalTable,
        image: ProcessImage,
        gate: InputGate,
        faults: Faults,
        parameters: LiveParameters,
        base_period_ns: int,
    ) -> None:
        self._table = table
        self._image = image
        self._gate = gate
        self._faults = faults
        self._parameters = parameters
        self._period_s = base_period_ns * 1e-9
        self.drives = False  # True from a scenario that drives until `stop`

    def check(self, play: Play) -> None:
        """Check every signal, range and peer; ConfigError names file, line and key."""
        scenario, path = play
        for index, fault in enumerate(scenario.faults):
            with placed(path, ("faults", index)):
                self._faults.check(fault)
        try:
            self._faults.check_all(scenario.faults)
        except ValueError as error:
            raise ConfigError(f"{place(path, ('faults',))}{error}") from None
        for index, step in enumerate(scenario.steps):
            for name, value in step.write.items():
                complaint = self._complaint(name, value)
                if complaint:
                    where = place(path, ("steps", index, "write", name))
                    raise ConfigError(f"{where}{complaint}")
        # Values that would not fit if nothing else changed meanwhile.
        values: dict[str, float] = {}
        for number, later in enumerate(scenario.steps):
            for parameter, wanted in later.set_.items():
                with placed(path, ("steps", number, "set", parameter)):
                    values |= self._parameters.checked({parameter: wanted})
            with placed(path, ("steps", number, "set")):
                self._parameters.try_out(values)

    def play(self, scenario: Scenario, start_tick: int = 0) -> None:
        """Hand a checked scenario to the plant; its times count from `start_tick`.

        ConfigError if it is too large for the queue of timed inputs, ControlRefused if it cannot
        take control or something leaves no room for it; then nothing has changed.
        """
        rows = sorted(self._rows(scenario, start_tick), key=lambda row: row.tick)
        self._expect_room(rows)
        try:
            self._faults.inject(*scenario.seeded_faults, start_tick=start_tick)
        except ValueError as error:
            raise ControlRefused(str(error)) from None
        if rows:
            self._gate.take("scenario")
            self.drives = True
        self._image.push_timed(rows)
        sets = sorted(self._sets(scenario, start_tick), key=itemgetter(0))
        self._parameters.schedule(sets, start_tick)

    def expect_room_again(self, scenario: Scenario) -> None:
        """ControlRefused if `play` would refuse the scenario after `Faults.reset`."""
        self._faults.expect_room(scenario.faults)
        self._expect_room(self._rows(scenario, 0))

    def _expect_room(self, rows: Sequence[Row]) -> None:
        """Raise what `play` says if the steps cannot be handed over."""
        if not rows:
            return
        self._gate.expect_take("scenario")
        if len(rows) > self._image.control.timed_capacity:
            raise ConfigError(
                f"{len(rows)} timed values are too many for the input queue"
            )
        if len(rows) > self._image.timed_room:
            raise ControlRefused(
                "too many steps of a scenario still wait; call Stop and Reset to end them, then try"
                " again"
            )

    def stop(self) -> None:
        """Cancel all further steps of a scenario."""
        self._faults.skip_timed()
        self._parameters.schedule()
        self.drives = False

    def _sets(
        self, scenario: Scenario, start_tick: int
    ) -> Iterator[tuple[int, dict[str, float]]]:
        for step in scenario.steps:
            if step.set_:
                tick = start_tick + round(step.at_s / self._period_s)
                yield tick, self._parameters.checked(step.set_)

    def _rows(self, scenario: Scenario, start_tick: int) -> list[Row]:
        rows: list[Row] = []
        for step in scenario.steps:
            tick = start_tick + round(step.at_s / self._period_s)
            for name, value in step.write.items():
                numbers = check_value(self._table[name], value)
                if isinstance(numbers, Refusal):
                    continue
                slots = self._table[name].slots
                places = [self._gate.leases.place("scenario", slot) for slot in slots]
                rows += [
                    Row(s, n, tick=tick) for s, n in zip(places, numbers, strict=True)
                ]
            rows += self._gate.stamps(step.write, tick * self._period_s, tick=tick)
        return rows

    def _complaint(self, name: str, value: Any) -> str:
        if name not in self._table or self._table[name].hidden:
            return no_signal(name, (signal.name for signal in self._table))
        signal = self._table[name]
        if not signal.writable:
            return f"'{name}' is an output; a fault or force can change it"
        if isinstance(check_value(signal, value), Refusal):
            return (
                f"{value!r} does not fit {name}: {signal.type} between"
                f" {signal.low:g} and {signal.high:g} {signal.unit}"
            )
        return ""


def as_yaml(scenario: Mapping[str, Any]) -> str:
    """Return a scenario made of plain data as it would stand in a file."""
    import yaml  # noqa: PLC0415 - only needed for writing

    text: str = yaml.safe_dump(
        dict(scenario), sort_keys=False, default_flow_style=None, width=100
    )
    return text

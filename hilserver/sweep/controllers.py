"""A controller in Python: called between two ticks, once per period.

::

    class Controller:
        def __call__(self, time_s, signals):
            return {"control.mode": 1, "twist.linear_m_s": 0.3 - signals["pose.x_m"]}

It is created anew for each machine. `signals` are those of the tick that has just ended; what it
returns is latched by the next tick.
"""

import random
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from hilserver.core.leases import Leases
from hilserver.core.refusal import Refusal, check_value
from hilserver.image import ProcessImage, Row
from hilserver.signals import Signal, SignalTable

WHO = "scenario"  # the source as which a controller drives


class WrongCommand(ValueError):
    """A controller returned something that is not a set of commands."""


class NewestValues(Mapping[str, float]):
    """The newest values, by name."""

    def __init__(self, image: ProcessImage, table: SignalTable) -> None:
        self.seed = 0  # of the machine; for a controller that draws random numbers
        self._values = image.frame_values
        self._slots = {s.name: s.slots[0] for s in table if not s.is_array}

    def __getitem__(self, name: str) -> float:
        return float(self._values[self._slots[name]])

    def __iter__(self) -> Iterator[str]:
        return iter(self._slots)

    def __len__(self) -> int:
        return len(self._slots)


class ControllerDriver:
    """Calls controllers and passes on their commands."""

    def __init__(
        self,
        make: Callable[[], Callable[[float, NewestValues], Any]],
        image: ProcessImage,
        table: SignalTable,
        leases: Leases,
        period_s: float,
    ) -> None:
        self._make = make
        self._image = image
        self._table = table
        self._period_s = period_s
        self._leases = leases
        self._signals = NewestValues(image, table)
        self._known: dict[str, Signal] = {}
        self._newest: dict[str, Any] = {}
        self._controller: Callable[[float, NewestValues], Any] = _no_controller
        # commands, by the tick that latches them; only changes
        self.written: list[tuple[int, dict[str, Any]]] = []

    def begin(self, seed: int) -> None:
        """Create the controller of a machine."""
        random.seed(seed)
        np.random.seed(seed % 2**32)  # noqa: NPY002 - a controller may use it unseeded
        self._signals.seed = seed
        self.written = []
        self._newest = {}
        self._controller = self._make()
        if not callable(self._controller):
            raise WrongCommand("the controller cannot be called with (time_s, signals)")

    def act(self, tick: int) -> None:
        """Call the controller after `tick`; the next one latches what it commands.

        WrongCommand if it returned something that no robot can be commanded.
        """
        commands = self._controller(tick * self._period_s, self._signals)
        if commands is None:
            return
        if not isinstance(commands, Mapping):
            raise WrongCommand(
                f"returned {commands!r:.60}; it must return a mapping of input signals to values"
            )
        # `...` equals no command, not even None.
        changed = {n: v for n, v in commands.items() if self._newest.get(n, ...) != v}
        rows = [
            row for name, value in changed.items() for row in self._rows(name, value)
        ]
        if not rows:
            return
        self._newest |= changed
        self.written.append((tick + 1, changed))
        if not self._image.push(rows):
            raise WrongCommand(
                f"commands {len(rows)} values at once, too many for the queue"
            )

    def end(self) -> None:
        """Release the controller and all that it holds."""
        self._controller = _no_controller

    def _rows(self, name: str, value: Any) -> Iterator[Row]:
        signal = self._known.get(name)
        if signal is None:
            if name not in self._table or not self._table[name].writable:
                raise WrongCommand(
                    f"commands '{name!s:.60}', which is not an input of the robot"
                )
            signal = self._known[name] = self._table[name]
        if isinstance(value, np.generic):
            value = value.item()
        numbers = check_value(signal, value)
        if isinstance(numbers, Refusal):
            text = numbers.value.replace("_", " ")
            raise WrongCommand(
                f"commands {name} = {value!r:.60}: {text}, {signal.range_text}"
            )
        for slot, number in zip(signal.slots, numbers, strict=True):
            yield Row(self._leases.place(WHO, slot), number)


def _no_controller(_time_s: float, _signals: NewestValues) -> None:
    return None

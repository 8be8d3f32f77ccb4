"""Watches the gap of a running daemon, frame by frame."""

from typing import Final

from hilserver.image import Frame
from hilserver.io.world import World
from hilserver.plant.layout import WHEELS
from hilserver.recalibration.change import ChangeDetector, Residuals
from hilserver.signals import MEASURED
from hilserver.status import GOOD

DRIVEN_RPM: Final = 1.0


class ChangeWatch:
    """Takes frames; all of them come from the same model until `restart`."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._residuals = Residuals()
        self._detector = ChangeDetector()

    def restart(self) -> None:
        """Forget what was usual."""
        self._detector.restart()

    def take(self, frame: Frame) -> str | None:
        """Take a frame; return the channel whose gap has grown, None if all are as usual."""
        table = self._world.table
        gate = self._world.gate
        measured: dict[str, float] = {}
        simulated: dict[str, float] = {}
        for name in gate.measured:
            if table[name].writable:
                continue  # a set-point is an input of the model
            there = table.slot(f"{MEASURED}{name}")
            here = table.slot(name)
            if frame.status[there] == GOOD and frame.status[here] == GOOD:
                measured[name] = float(frame.values[there])
                simulated[name] = float(frame.values[here])
        speeds = [frame.values[table.slot(f"wheel.{w}.speed_rpm")] for w in WHEELS]
        moves = any(abs(speed) > DRIVEN_RPM for speed in speeds)
        t_s = float(frame.values[table.slot("sim.time_s")])
        return self._detector.take(
            self._residuals.take(t_s, measured, simulated, moves=moves)
        )

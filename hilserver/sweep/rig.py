"""Drives machines of one sweep one after the other: one image, one compiled step, many robots.

Every machine begins with the same bytes in the image, so nothing is left of the previous one.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilserver.arrays import Array
from hilserver.config.loading import placed
from hilserver.daemon.assembly import Assembly, assemble_config
from hilserver.daemon.builder import Pace, build, faults_of
from hilserver.faults.scenario import Play, Scenario
from hilserver.parameters.table import BLOCK
from hilserver.plant.layout import Parameters
from hilserver.program.own_python import described, load_callable
from hilserver.requirements import CheckError, Drive, Judge
from hilserver.scheduler.faults import SLICE, fault_of
from hilserver.signals import SignalTable, State
from hilserver.sweep.controllers import ControllerDriver, WrongCommand
from hilserver.sweep.limits import OutOfTime, limited
from hilserver.sweep.loop import run_ticks
from hilserver.sweep.prepare import PATH_ERROR, SentMachine, SweepJob

RING_FRAMES, QUEUE_ROWS = 16, 1 << 15


@dataclass(frozen=True)
class MachineOutcome:
    """What became of a machine."""

    index: int
    # in the order of the requirements; empty if it could not be driven
    margins: tuple[float, ...] = ()
    error: str = ""  # why not: the controller raised, took too long, commanded nonsense
    refused: str = ""  # why there is no such machine

    @property
    def passed(self) -> bool:
        """Whether every requirement is met."""
        return bool(self.margins) and min(self.margins) >= 0.0


class _Broken(Exception):
    """The compiled step gave up; the text says why."""


class Rig:
    """One robot that becomes each machine of a job in turn."""

    def __init__(self, job: SweepJob) -> None:
        self.job = job
        assembly = assemble_config(job.config, job.folder)
        self._period_ns = assembly.base_period_ns
        self._table = assembly.table
        self._core = build(
            assembly, Pace(image="", ring_frames=RING_FRAMES, queue_rows=QUEUE_ROWS)
        )
        self._image = self._core.image
        self._image.control.state = State.RUNNING
        self._judge, self._kept = judge_of(job, self._table)
        slots = [self._table.slot(name) for name in self._kept]
        self._slots = np.array(slots, dtype=np.int64)
        self._values = np.zeros((len(self._kept), job.n_ticks))
        self._periods = np.array(
            [s.period_ticks for s in assembly.slices if s.compiled], dtype=np.int64
        )
        self.driver = self._driver(assembly)
        # All values of the scenario go into the queue.
        core = self._core
        played = self.job
        stage = core.stage()
        stage.check(Play(played.scenario, played.scenario_path))
        for index, item in enumerate(played.sweep.faults):
            with placed(played.path, ("faults", index, "fault")):
                core.faults.check(item.fault)
        stage.play(played.scenario.changed(faults=()))
        self._fresh = self._image.words.copy()

    def _driver(self, assembly: Assembly) -> ControllerDriver | None:
        controller = self.job.sweep.controller
        if controller is None or controller.python is None:
            return None
        make = load_callable(controller.python, self.job.path.parent)
        period_s = self._period_ns * 1e-9
        leases = self._core.gate.leases
        self._every = max(
            round((controller.every_ms or 0.0) * 1e6 / self._period_ns), 1
        )
        return ControllerDriver(make, self._image, assembly.table, leases, period_s)

    def drive(self, machine: SentMachine) -> MachineOutcome:
        """Drive one machine and judge it; whatever its controller does, this returns."""
        if machine.p is None:
            return MachineOutcome(machine.index, refused=machine.refused)
        try:
            with limited(self.job.sweep.limits.time_s):
                self._begin(machine, machine.p)
                self._run()
                columns = dict(zip(self._kept, self._values, strict=True))
                margins = margins_of(self.job, self._judge, self._period_ns, columns)
                return MachineOutcome(machine.index, margins)
        except OutOfTime:
            error = f"took longer than {self.job.sweep.limits.time_s:g} s"
        except MemoryError:
            error = f"needed more than {self.job.sweep.limits.memory_mb:g} MB of memory"
        except WrongCommand as problem:
            error = f"the controller {problem}"
        except (_Broken, CheckError) as problem:
            error = str(problem)
        except BaseException as problem:
            if isinstance(problem, KeyboardInterrupt) or _is_ours(problem):
                raise
            error = f"the controller raised {described(problem)}"
        finally:
            if self.driver is not None:
                self.driver.end()
        return MachineOutcome(machine.index, error=error)

    def _begin(self, machine: SentMachine, packed: NDArray[np.float64]) -> None:
        """Make the robot that machine, before its first tick."""
        image = self._image
        regions = self._image.layout.regions
        image.words[:] = self._fresh
        p = regions["p"].base
        x = regions["x"]
        image.values[p : p + len(packed)] = packed
        image.values[x.base : x.base + x.length] = 0.0
        for word, value in machine.state.items():
            image.values[x.base + word] = value
        for use in self._core.assembly.composition.blocks:
            base = regions[f"{use.name}.p"].base
            for number, name in enumerate(use.declaration.parameters):
                drawn = machine.values.get(f"{BLOCK}{use.name}.{name}")
                if drawn is not None:
                    image.values[base + number] = drawn
        faults = scenario_of(self.job.scenario, machine).seeded_faults
        if faults:
            parameters = Parameters.of(packed)
            events = self._core.events
            book = faults_of(image, self._table, self._period_ns, parameters, events)
            book.inject(*faults, start_tick=0)
        if self.driver is not None:
            self.driver.begin(machine.seed)

    def _run(self) -> None:
        n = self.job.n_ticks
        driver = self.driver
        if driver is None:
            self._advance(0, n)
            return
        self._advance(0, 1)
        for first in range(0, n, self._every):
            driver.act(first)
            n_ticks = min(self._every, n - first - 1)
            self._advance(first + 1, n_ticks)

    def _advance(self, first: int, n_ticks: int) -> None:
        image = self._image
        fault = run_ticks(
            self._core.step,
            self._periods,
            self._period_ns,
            first,
            n_ticks,
            self._slots,
            self._values,
            image.values,
            image.words,
        )
        if fault:
            raise _Broken(self._words_for(fault))

    def _words_for(self, fault: int) -> str:
        blocks = self._core.assembly.composition.blocks
        at_s = self._image.frame_values[self._table.slot("sim.time_s")]
        if 0 < fault <= len(blocks):
            return f"the block '{blocks[fault - 1].name}' raised an exception at {at_s:.3f} s"
        return f"{fault_of(SLICE + fault).text} at {at_s:.3f} s"

    @property
    def written(self) -> list[tuple[int, dict[str, Any]]]:
        """Commands of a Python controller to the last machine, by the tick that latched them."""
        return [] if self.driver is None else self.driver.written


def judge_of(job: SweepJob, table: SignalTable) -> tuple[Judge, tuple[str, ...]]:
    """Return the judge of a drive, and the signals to keep for it and for those it derives."""
    if job.sweep.drive.path is None:
        judge = Judge(job.sweep.require, table, job.path)
        return judge, judge.signals
    judge = Judge(job.sweep.require, table, job.path, (PATH_ERROR,))
    names = [name for name in judge.signals if name != PATH_ERROR]
    return judge, tuple(dict.fromkeys((*names, "pose.x_m", "pose.y_m")))


def margins_of(
    job: SweepJob, judge: Judge, period_ns: int, columns: Mapping[str, Array]
) -> tuple[float, ...]:
    """Return the margins of a drive from the values of every tick, in the requirements' order."""
    own = dict(columns)
    if (way := job.sweep.drive.path) is not None:
        own[PATH_ERROR] = distance_to_way(
            own["pose.x_m"], own["pose.y_m"], np.array(way)
        )
    return tuple(judge.margins(Drive(period_ns * 1e-9, own)).values())


def distance_to_way(x_m: Array, y_m: Array, way: Array) -> Array:
    """Return the distance of points to the nearest segment of a polyline [m], shape (n,).

    Parameters
    ----------
    x_m, y_m : ndarray, shape (n,)
    way : ndarray, shape (k, 2)
        Corners, at least two.
    """
    nearest = np.full(len(x_m), np.inf)
    for (ax, ay), (bx, by) in pairwise(way.tolist()):
        dx = bx - ax
        dy = by - ay
        length2 = dx * dx + dy * dy
        along = np.zeros(len(x_m))
        if length2 > 0.0:
            projected = (x_m - ax) * dx + (y_m - ay) * dy
            along = np.clip(projected / length2, 0.0, 1.0)
        aside_x = x_m - ax - along * dx
        aside_y = y_m - ay - along * dy
        square = aside_x**2 + aside_y**2
        nearest = np.minimum(nearest, square)
    distance: Array = np.sqrt(nearest)
    return distance


def scenario_of(scenario: Scenario, machine: SentMachine) -> Scenario:
    """Return the scenario with the machine's faults."""
    own = tuple(fault for _, fault in machine.faults)
    if own:
        return scenario.changed(faults=(*scenario.faults, *own))
    return scenario


def _is_ours(problem: BaseException) -> bool:
    """Whether it is the end of the program, requested by a signal."""
    from hilserver.program.ending import end_was_asked  # noqa: PLC0415

    return isinstance(problem, SystemExit) and end_was_asked()

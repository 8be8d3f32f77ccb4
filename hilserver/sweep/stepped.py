"""A controller that is a process: an OPC UA client that steps the robot, which waits for it.

Every machine is a daemon of its own, paused in virtual time; the process is started with its
address, writes commands and calls Step. Whatever the process does, a machine ends: with the drive,
with the process, or when its time is over.
"""

import asyncio
import contextlib
from typing import Any, Final

import numpy as np

from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.faults.scenario import Play
from hilserver.image import read_frames
from hilserver.io.opcua_server import server as opcua_server
from hilserver.monitoring.logging_setup import setup_logging
from hilserver.program.guest import Guest, NotStarted, filled, guest
from hilserver.requirements import CheckError
from hilserver.scheduler.faults import fault_of
from hilserver.signals import Signal, State, ValueType
from hilserver.sweep.configuration import machine_config
from hilserver.sweep.prepare import SentMachine, SweepJob
from hilserver.sweep.rig import MachineOutcome, judge_of, margins_of, scenario_of
from hilserver.tasks import first_of

ENDPOINT, SEED = "{endpoint}", "{seed}"
"""Placeholders in a command for the robot's address and the machine's seed."""
_ADDRESS: Final = "opc.tcp://127.0.0.1:0/hilserver"


class _Failed(Exception):
    """The machine fails; the text says why."""


class Stepped:
    """Drives machines one after the other, each with a process of its own."""

    def __init__(self, job: SweepJob) -> None:
        setup_logging("ERROR")
        self.job = job
        # commands of the last machine's process, by the tick that latched them
        self.written: list[tuple[int, dict[str, Any]]] = []
        assembly = assemble_config(job.config, job.folder)
        self._judge, self._kept = judge_of(job, assembly.table)

    def drive(self, machine: SentMachine) -> MachineOutcome:
        """Drive one machine and judge it; whatever its controller does, this returns."""
        self.written = []
        if machine.p is None:
            return MachineOutcome(machine.index, refused=machine.refused)
        try:
            return MachineOutcome(machine.index, asyncio.run(self._margins(machine)))
        except (_Failed, NotStarted, CheckError) as problem:
            return MachineOutcome(machine.index, error=str(problem))

    async def _margins(self, machine: SentMachine) -> tuple[float, ...]:
        """Drive and return the margins; _Failed if there are none."""
        job = self.job
        config = Config.model_validate(machine_config(job.config, job.folder, machine))
        # Only programs of this computer can reach its server.
        opcua = type(config.opcua)(endpoint=_ADDRESS)
        reachable = config.changed(opcua=opcua, control={"source": "opcua"})
        assembly = assemble_config(reachable, job.folder)
        play = Play(scenario_of(job.scenario, machine), job.scenario_path)
        daemon = Daemon(assembly, play=play, paused=True, links=(opcua_server.parts,))
        async with daemon:
            daemon.control.pause()
            watch = _Watch(daemon, self._kept, job.n_ticks)
            async with self._guest(daemon, machine) as controller:
                await self._wait(controller, watch)
        self.written = watch.written
        columns = dict(zip(self._kept, watch.values, strict=True))
        return margins_of(job, self._judge, assembly.base_period_ns, columns)

    def _guest(
        self, daemon: Daemon, machine: SentMachine
    ) -> contextlib.AbstractAsyncContextManager[Guest]:
        """Run the controller while the context lasts; processes that it started end with it."""
        given = self.job.sweep.controller
        assert given is not None
        own = {ENDPOINT: daemon.part("opcua").url, SEED: str(machine.seed)}
        words = [filled(word, own) for word in given.command]
        limits = self.job.sweep.limits
        return guest(
            words,
            memory_mb=limits.memory_mb,
            cwd=self.job.path.parent,
            stdout=asyncio.subprocess.DEVNULL,
        )

    async def _wait(self, controller: Guest, watch: "_Watch") -> None:
        """Wait for the drive's last tick; _Failed if it does not come."""
        time_s = self.job.sweep.limits.time_s
        await first_of(watch.over.wait(), controller.wait(), within_s=time_s)
        if watch.problem:
            raise _Failed(watch.problem)
        if watch.is_complete:
            return
        if not controller.has_ended:
            raise _Failed(
                f"took longer than {time_s:g} s: {watch.place}, the controller no longer steps"
            )
        raise _Failed(f"the controller {controller.ending}; {watch.place}")


class _Watch:
    """Collects the values of every tick and the controller's commands."""

    def __init__(self, daemon: Daemon, kept: tuple[str, ...], n_ticks: int) -> None:
        self._daemon = daemon
        self._n = n_ticks
        self._done = 0
        self._slots = [daemon.table.slot(name) for name in kept]
        self._inputs = [
            s for s in daemon.table if s.writable and not s.is_array and not s.hidden
        ]
        self._newest = np.array([s.initial for s in self._inputs])
        self._next = daemon.image.head
        self.values = np.zeros((len(kept), n_ticks))
        self.written: list[tuple[int, dict[str, Any]]] = []
        # set by the last tick, or by a problem
        self.over = asyncio.Event()
        self.problem = ""
        daemon.scheduler.after_batch.append(self._look)

    @property
    def is_complete(self) -> bool:
        """Whether the drive is over."""
        return self._done >= self._n

    @property
    def place(self) -> str:
        """How far the drive has got, in words."""
        period_s = self._daemon.assembly.base_period_ns * 1e-9
        reached_s = self._done * period_s
        asked_s = self._n * period_s
        return f"the drive reached {reached_s:g} s of {asked_s:g} s"

    def _look(self) -> None:
        image = self._daemon.image
        control = self._daemon.control
        if n := image.head - self._next:
            frames = read_frames(image, self._next, n)
            self._next += n
            self._take(frames.ticks, frames.values)
        if self.is_complete:
            self.over.set()
        elif code := image.control.first_fault:
            self._fail(f"{fault_of(code).text}; {self.place}")
        elif control.state not in (State.PAUSED, State.STOPPING):
            self._fail(
                f"the controller let the robot run freely ({control.reason}); in lockstep it may"
                f" move the robot only with Step; {self.place}"
            )

    def _fail(self, why: str) -> None:
        self.problem = self.problem or why
        self.over.set()

    def _take(self, ticks: Any, values: Any) -> None:
        inside = ticks < self._n
        ticks = ticks[inside]
        values = values[inside]
        if not len(ticks):
            return
        if ticks[0] == 0:  # after a Reset the drive begins anew
            self.written, self._newest = [], np.array([s.initial for s in self._inputs])
        self.values[:, ticks] = values[:, self._slots].T
        inputs = values[:, [s.slots[0] for s in self._inputs]]
        before = np.vstack((self._newest, inputs[:-1]))
        for row in np.flatnonzero((inputs != before).any(axis=1)).tolist():
            changed = np.flatnonzero(inputs[row] != before[row]).tolist()
            signals = ((self._inputs[k], float(inputs[row, k])) for k in changed)
            self.written.append(
                (int(ticks[row]), {s.name: _typed(s, v) for s, v in signals})
            )
        self._newest = inputs[-1]
        self._done = int(ticks[-1]) + 1


def _typed(signal: Signal, value: float) -> bool | int | float:
    if signal.type is ValueType.BOOLEAN:
        return bool(value)
    return value if signal.type is ValueType.DOUBLE else int(value)

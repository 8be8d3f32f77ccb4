"""A controller that is a process: an OPC UA client that steps the robot, which waits for it.

Every machine is a daemon of its own, paused in virtual time; the process is started with its
address, writes commands and calls Step. Whatever the process does, a machine ends: with the drive,
with the process, or when its time is over.
"""

import asyncio
import contextlib
import os
import signal
from collections import deque
from collections.abc import AsyncIterator
from functools import partial
from resource import RLIMIT_DATA, prlimit
from typing import Any, Final

import numpy as np

from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.faults.scenario import Play
from hilserver.image import read_frames
from hilserver.io.opcua_server import server as opcua_server
from hilserver.monitoring.logging_setup import setup_logging
from hilserver.program.children import end, how_ended
from hilserver.program.workers import end_with_parent
from hilserver.requirements import CheckError
from hilserver.scheduler.faults import fault_of
from hilserver.signals import Signal, State, ValueType
from hilserver.sweep.configuration import machine_config
from hilserver.sweep.prepare import Job, Machine
from hilserver.sweep.rig import Outcome, judge_of, margins_of, scenario_of
from hilserver.tasks import first_of
from hilserver.time_limit import time_limit

ENDPOINT, SEED = "{endpoint}", "{seed}"
"""Placeholders in a command for the robot's address and the machine's seed."""
_ADDRESS: Final = "opc.tcp://127.0.0.1:0/hilserver"
_LAST_LINES: Final = 20


class _Failed(Exception):
    """The machine fails; the text says why."""


class Stepped:
    """Drives machines one after the other, each with a process of its own."""

    def __init__(self, job: Job) -> None:
        setup_logging("ERROR")
        self.job = job
        # commands of the last machine's process, by the tick that latched them
        self.written: list[tuple[int, dict[str, Any]]] = []
        assembly = assemble_config(job.config, job.folder)
        self._judge, self._kept = judge_of(job, assembly.table)

    def drive(self, machine: Machine) -> Outcome:
        """Drive one machine and judge it; whatever its controller does, this returns."""
        self.written = []
        if machine.p is None:
            return Outcome(machine.index, refused=machine.refused)
        try:
            return Outcome(machine.index, asyncio.run(self._margins(machine)))
        except (_Failed, CheckError) as problem:
            return Outcome(machine.index, error=str(problem))

    async def _margins(self, machine: Machine) -> tuple[float, ...]:
        """Drive and return the margins; _Failed if there are none."""
        job = self.job
        config = Config.model_validate(machine_config(job.config, job.folder, machine))
        assembly = assemble_config(_reachable(config), job.folder)
        play = Play(scenario_of(job.scenario, machine), job.scenario_path)
        daemon = Daemon(assembly, play=play, paused=True, links=(opcua_server.parts,))
        async with daemon:
            daemon.control.pause()
            watch = _Watch(daemon, self._kept, job.n_ticks)
            async with self._process(daemon, machine) as process:
                await self._wait(process, watch)
        self.written = watch.written
        columns = dict(zip(self._kept, watch.values, strict=True))
        return margins_of(job, self._judge, assembly.base_period_ns, columns)

    @contextlib.asynccontextmanager
    async def _process(
        self, daemon: Daemon, machine: Machine
    ) -> "AsyncIterator[asyncio.subprocess.Process]":
        """Run the controller while the context lasts; processes that it started end with it."""
        given = self.job.sweep.controller
        assert given is not None
        own = {ENDPOINT: daemon.part("opcua").url, SEED: str(machine.seed)}
        words = [_filled(word, own) for word in given.command]
        try:
            process = await asyncio.create_subprocess_exec(
                *words,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.DEVNULL,
                stderr=asyncio.subprocess.PIPE,
                cwd=self.job.path.parent,
                start_new_session=True,
                preexec_fn=partial(end_with_parent, os.getpid()),
            )
        except OSError as error:
            why = (error.strerror or "refused").lower()
            raise _Failed(
                f"the controller '{words[0]}' cannot be started: {why}"
            ) from None
        try:
            most = int(self.job.sweep.limits.memory_mb * 1e6)
            with contextlib.suppress(OSError):  # it has ended already
                prlimit(process.pid, RLIMIT_DATA, (most, most))
            yield process
        finally:
            with contextlib.suppress(OSError):
                os.killpg(process.pid, signal.SIGKILL)
            await end(process, words[0], 0)

    async def _wait(self, process: asyncio.subprocess.Process, watch: "_Watch") -> None:
        """Wait for the drive's last tick; _Failed if it does not come."""
        lines: deque[str] = deque(maxlen=_LAST_LINES)
        time_s = self.job.sweep.limits.time_s
        first = await first_of(
            watch.over.wait(), _keep(process, lines), within_s=time_s
        )
        # It closes its error output a moment before its exit code is there.
        if first == 1:
            with contextlib.suppress(TimeoutError):
                async with time_limit(1.0):
                    await process.wait()
        if watch.problem:
            raise _Failed(watch.problem)
        if watch.is_complete:
            return
        if process.returncode is None:
            raise _Failed(
                f"took longer than {time_s:g} s: {watch.place}, the controller no longer steps"
            )
        raise _Failed(
            f"the controller {_ending(process.returncode, lines)}; {watch.place}"
        )


class _Watch:
    """Collects the values of every tick and the controller's commands."""

    def __init__(self, daemon: Daemon, kept: tuple[str, ...], n_ticks: int) -> None:
        self._daemon, self._n, self._done = daemon, n_ticks, 0
        self._slots = [daemon.table.slot(name) for name in kept]
        self._inputs = [
            s for s in daemon.table if s.writable and not s.is_array and not s.hidden
        ]
        self._newest = np.array([s.initial for s in self._inputs])
        self._next = daemon.image.head
        self.values = np.zeros((len(kept), n_ticks))
        self.written: list[tuple[int, dict[str, Any]]] = []
        self.over, self.problem = (
            asyncio.Event(),
            "",
        )  # set by the last tick, or by a problem
        daemon.scheduler.after_batch.append(self._look)

    @property
    def is_complete(self) -> bool:
        """Whether the drive is over."""
        return self._done >= self._n

    @property
    def place(self) -> str:
        """How far the drive has got, in words."""
        period_s = self._daemon.assembly.base_period_ns * 1e-9
        return (
            f"the drive reached {self._done * period_s:g} s of {self._n * period_s:g} s"
        )

    def _look(self) -> None:
        image, control = self._daemon.image, self._daemon.control
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
        ticks, values = ticks[inside], values[inside]
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
        self._newest, self._done = inputs[-1], int(ticks[-1]) + 1


def _reachable(config: Config) -> Config:
    """Return the robot with a server that only programs of this computer can reach."""
    opcua = type(config.opcua)(endpoint=_ADDRESS)
    return config.changed(opcua=opcua, control={"source": "opcua"})


def _filled(word: str, values: dict[str, str]) -> str:
    for name, value in values.items():
        word = word.replace(name, value)
    return word


def _typed(signal: Signal, value: float) -> bool | int | float:
    if signal.type is ValueType.BOOLEAN:
        return bool(value)
    return value if signal.type is ValueType.DOUBLE else int(value)


async def _keep(process: asyncio.subprocess.Process, lines: "deque[str]") -> None:
    """Read the error output of a process until it is closed, and keep its end."""
    assert process.stderr is not None
    rest = b""
    while piece := await process.stderr.read(4096):
        *whole, rest = (rest + piece).split(b"\n")
        rest = rest[-4096:]
        lines.extend(
            line.decode("utf-8", "replace").strip() for line in whole if line.strip()
        )
    if rest.strip():
        lines.append(rest.decode("utf-8", "replace").strip())


def _ending(code: int, lines: "deque[str]") -> str:
    """Return how a process ended, with its error message."""
    how = how_ended(code)
    if code == 0:
        return how
    said = [line for line in lines if "rror" in line] or list(lines)
    return f"{how}: {said[-1]:.200}" if said else how

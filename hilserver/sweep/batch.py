"""What a worker does: drive some machines, and identify the computer they ran on."""

import hashlib
import math
import platform
import signal
from collections.abc import Sequence
from functools import cache

import numpy as np

from hilserver.compiled import kernel_hash
from hilserver.program.workers import end_with_parent
from hilserver.sweep.limits import limit_memory
from hilserver.sweep.prepare import SentMachine, SweepJob
from hilserver.sweep.rig import MachineOutcome, Rig
from hilserver.sweep.stepped import Stepped

_PROBES = np.linspace(-3.0, 3.0, 41)


@cache
def fingerprint() -> str:
    """Return what computers must have in common for the same bits: kernels, processor, libm."""
    functions = (math.sin, math.cos, math.tan, math.exp, math.atan, math.tanh, math.erf)
    values = [f(x) for f in functions for x in _PROBES.tolist()]
    values += [math.log(abs(x) + 0.1) for x in _PROBES.tolist()]
    digest = hashlib.sha256(np.array(values).tobytes()).hexdigest()[:16]
    return f"{kernel_hash()}-{platform.machine()}-{digest}"


def begin_worker(parent: int, memory_mb: float) -> None:
    """Prepare a worker process of this computer."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by its parent
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    end_with_parent(parent)
    limit_memory(memory_mb)


def rig_for(job: SweepJob) -> Rig | Stepped:
    """Return what drives the machines of a job."""
    given = job.sweep.controller
    if given is None or not given.command:
        return Rig(job)
    return Stepped(job)


_rigs: dict[str, Rig | Stepped] = {}


def run_batch(
    job: SweepJob, machines: Sequence[SentMachine]
) -> tuple[str, list[MachineOutcome]]:
    """Drive machines one after the other; return the fingerprint and what became of them."""
    if job.key not in _rigs:
        _rigs.clear()
        _rigs[job.key] = rig_for(job)
    rig = _rigs[job.key]
    return fingerprint(), [rig.drive(machine) for machine in machines]

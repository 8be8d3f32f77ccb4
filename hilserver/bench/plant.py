"""How long one tick of the plant takes, compared with the same recurrence in C.

Blocks of both programs alternate in one run, so that other work of the machine affects both; the
median over the blocks is compared. The C program is built for this machine, with -O3 and without
fast-math.
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numba
import numpy as np

from hilserver.bench.report import Result
from hilserver.compiled import kernel
from hilserver.plant.layout import (
    INPUTS,
    OUTPUTS,
    PARAMETERS,
    STATE,
    STATUS,
    Inputs,
    Outputs,
    Status,
)
from hilserver.plant.packing import initial_state, pack
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.reference.cases import cases
from hilserver.plant.reference.library import FLAGS, ReferencePlant, build
from hilserver.plant.robot import robot_step

BLOCKS: Final = 21
TICKS_PER_BLOCK: Final = 200_000

_P, _X, _U, _Y, _Q = map(numba.from_dtype, (PARAMETERS, STATE, INPUTS, OUTPUTS, STATUS))
_STEP = numba.types.FunctionType(numba.void(_P, _X, _U, _Y, _Q))


@kernel()
def _direct(p: Any, x: Any, u: Any, y: Any, q: Any, ticks: int) -> None:
    for _ in range(ticks):
        robot_step(p, x, u, y, q)


@kernel(numba.void(_STEP, _P, _X, _U, _Y, _Q, numba.int64))
def _through_pointer(
    step: Any, p: Any, x: Any, u: Any, y: Any, q: Any, ticks: int
) -> None:
    for _ in range(ticks):
        step(p, x, u, y, q)


class _Numba:
    """One compiled robot with its arrays, driving a curve."""

    def __init__(self, robot: RobotParameters) -> None:
        self.p = pack(robot)
        self.x = initial_state(robot)
        self.u, self.y, self.q = _inputs()

    def direct(self, ticks: int) -> None:
        _direct(self.p, self.x, self.u, self.y, self.q, ticks)

    def pointer(self, ticks: int) -> None:
        _through_pointer(robot_step, self.p, self.x, self.u, self.y, self.q, ticks)


def _inputs() -> tuple[Inputs, Outputs, Status]:
    u = Inputs.zeros()
    u.enable = 1.0
    u.setpoint[:] = 60.0, 60.0, -40.0, -40.0
    return u, Outputs.zeros(), Status.zeros()


def run(args: argparse.Namespace) -> list[Result]:
    """Measure and return ``step_ns``, ``step_pointer_ns`` and ``step_all_terms_ns``.

    FailedError if there is no C compiler.
    """
    blocks = int(getattr(args, "blocks", None) or BLOCKS)
    ticks = int(getattr(args, "ticks", None) or TICKS_PER_BLOCK)
    base = _Numba(RobotParameters())
    extended = _Numba(RobotParameters(terms=cases()["everything"]))
    u, y, q = _inputs()
    with tempfile.TemporaryDirectory() as folder:
        library = build(Path(folder))
        c = ReferencePlant(library, RobotParameters(), battery_v=19.2, extended=False)

        def in_c(n: int) -> None:
            words = q.numbers.view(np.int64)
            c.run(u.numbers, y.numbers, words, n)

        programs: dict[str, Callable[[int], None]] = {
            "c": in_c,
            "direct": base.direct,
            "pointer": base.pointer,
            "all_terms": extended.direct,
        }
        for warm_up in programs.values():
            warm_up(1000)
        samples: dict[str, list[float]] = {name: [] for name in programs}
        for _ in range(blocks):
            for name, program in programs.items():
                start_ns = time.perf_counter_ns()
                program(ticks)
                tick_ns = (time.perf_counter_ns() - start_ns) / ticks
                samples[name].append(tick_ns)
        c.close()
    median = {name: statistics.median(values) for name, values in samples.items()}
    command = " ".join(("gcc", *FLAGS))
    raw = {"blocks_ns": samples, "ticks_per_block": ticks, "c": command}

    def result(name: str, program: str) -> Result:
        value = median[program]
        reference = median["c"]
        return Result(
            name, value, "ns", reference, "C, terms off", value / reference, raw
        )

    return [
        result("step_ns", "direct"),
        result("step_pointer_ns", "pointer"),
        result("step_all_terms_ns", "all_terms"),
    ]

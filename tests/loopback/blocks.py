"""Own blocks of the loopback tests."""

import math

from hilserver.plant.blocks import Output, block

RUNS_PER_UNIT = 1_500_000


@block(
    inputs=("busy",),
    outputs=(Output("sum_1", unit="1", low=-1e12, high=1e12),),
    state=("last", "sum"),
)
def busy(dt_s, u, y, x, p):
    """Compute for some ten milliseconds in the tick in which its input changes to above 0."""
    if u[0] != x[0]:
        x[0] = u[0]
        for i in range(int(u[0]) * RUNS_PER_UNIT):
            x[1] += math.sin(i * 1e-3)
    y[0] = x[1]


@block(inputs=("busy",), outputs=(Output("sum_1", unit="1"),))
def always_busy(dt_s, u, y, x, p):
    """Compute for some ten milliseconds in every tick."""
    y[0] = 0.0
    for i in range(RUNS_PER_UNIT):
        y[0] += math.sin(i * 1e-3)

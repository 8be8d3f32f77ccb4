"""An own block that takes longer than a tick while a light is red: overruns by order."""

from hilserver.plant.blocks import Output, block


@block(inputs=("red",), outputs=(Output("load_pct", unit="%", low=0.0, high=1e9),))
def burn(dt_s, u, y, x, p):
    total = 0.0
    for i in range(int(u[0]) * 40_000):
        total += 1.0 / (1.0 + i + total)
    y[0] = total

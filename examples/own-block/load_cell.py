"""A load cell that follows the duty of a wheel with a lag."""

from hilserver.plant.blocks import Output, block


@block(
    inputs=("duty_pct",),
    outputs=(
        Output(
            "force_n", unit="N", low=-50.0, high=50.0, description="Load cell, axle fl"
        ),
    ),
    state=("force",),
    parameters={"gain_n_pct": 0.4, "lag_s": 0.1},
)
def load_cell(dt_s, u, y, x, p):
    """Follow the duty with a first-order lag."""
    gain, lag_s = p[0], p[1]
    x[0] += dt_s / (lag_s + dt_s) * (gain * u[0] - x[0])
    y[0] = x[0]

"""What runs of the mechatronic model in the slices, called like `parts` by the generated step."""

from typing import Any

from hilserver.body.layout import N_A, N_M
from hilserver.body.layout import N_P as N_BODY_P
from hilserver.body.slice import body_imu, body_ranges, hand_over_wheels, run_slice
from hilserver.kernel.places import BodyPlaces, Places, p, q, u, x, y
from hilserver.plant.kernels import inlined


@inlined
def body(at: Places, body_at: BodyPlaces, values: Any, words: Any) -> int:
    """Show the body of t_k and compute the next slice; return its fault."""
    return int(
        run_slice(
            values[body_at.p : body_at.p + N_BODY_P],
            values[body_at.b : body_at.b_end],
            words[body_at.a : body_at.a + N_A],
            p(at, values),
            x(at, values),
            u(at, values),
            y(at, values),
            values[at.hall : at.hall_end],
            values[body_at.out : body_at.out + N_M],
            words[body_at.status : body_at.status + N_M],
        )
    )


@inlined
def body_wheels(at: Places, body_at: BodyPlaces, values: Any, words: Any) -> None:  # noqa: ARG001
    """Hand the wheels' speeds to the plant; runs before it."""
    hand_over_wheels(values[body_at.b : body_at.b_end], x(at, values))


@inlined
def imu(at: Places, body_at: BodyPlaces, values: Any, words: Any) -> None:
    """Show what the inertial unit measures in the body."""
    body_imu(
        values[body_at.b : body_at.b_end],
        p(at, values),
        x(at, values),
        y(at, values),
        q(at, words),
    )


@inlined
def tof(at: Places, body_at: BodyPlaces, values: Any, words: Any) -> None:
    """Show the four distances to the walls from where the body is."""
    body_ranges(
        values[body_at.b : body_at.b_end],
        p(at, values),
        y(at, values),
        q(at, words),
        values[at.hall : at.hall_end],
    )

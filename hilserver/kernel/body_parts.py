"""The mechatronic model's parts of the slices, called like `parts` by the generated step."""

from typing import Any

from hilserver.body.layout import ADDRESSES, CONSTANTS, MOTION, SIGNALS, Signals
from hilserver.body.slice import (
    body_imu,
    body_nav,
    body_ranges,
    hand_over_wheels,
    run_slice,
)
from hilserver.compiled import inlined
from hilserver.compiled.records import record_at
from hilserver.kernel.places import BodyPlaces, Places, p, q, u, x, y

N_SIGNALS = Signals.n_words


@inlined
def body(at: Places, body_at: BodyPlaces, values: Any, words: Any) -> int:
    """Show the body of t_k and compute the next slice; return its fault."""
    return int(
        run_slice(
            record_at(values, body_at.p, CONSTANTS),
            values[body_at.b : body_at.b_end],
            record_at(words, body_at.a, ADDRESSES),
            p(at, values),
            x(at, values),
            u(at, values),
            y(at, values),
            values[at.hall : at.hall_end],
            record_at(values, body_at.out, SIGNALS),
            words[body_at.status : body_at.status + N_SIGNALS],
        )
    )


@inlined
def body_wheels(at: Places, body_at: BodyPlaces, values: Any, words: Any) -> None:  # noqa: ARG001
    """Pass the wheels' speeds to the plant; runs before it."""
    hand_over_wheels(record_at(values, body_at.b, MOTION), x(at, values))


@inlined
def imu(at: Places, body_at: BodyPlaces, values: Any, words: Any) -> None:
    """Show what the inertial unit measures in the body."""
    b = record_at(values, body_at.b, MOTION)
    body_imu(b, p(at, values), x(at, values), y(at, values), q(at, words))


@inlined
def tof(at: Places, body_at: BodyPlaces, values: Any, words: Any) -> None:
    """Show the four distances to the walls from the body's place."""
    b, hall = record_at(values, body_at.b, MOTION), values[at.hall : at.hall_end]
    body_ranges(b, p(at, values), y(at, values), q(at, words), hall)


@inlined
def nav(at: Places, body_at: BodyPlaces, values: Any, words: Any) -> None:
    """Show the body's pose as the navigation tag measures it."""
    b = record_at(values, body_at.b, MOTION)
    body_nav(b, p(at, values), x(at, values), y(at, values), q(at, words))

"""Standard pieces from which a better manoeuvre is built.

Every piece begins and ends at rest and returns to where it began, by driving the same way backwards
or in a circle. So pieces can follow each other in a room of known size even if the real robot turns
or rolls differently from its model.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hilserver.diagnosis.plan.manoeuvre import Manoeuvre
from hilserver.diagnosis.plan.null_log import path_of
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.units import RAD_S_PER_RPM

Move = tuple[float, float, float]
"""Seconds, speeds of the left and the right wheels [rpm]; forward is positive."""

PAUSE: Final[Move] = (0.4, 0.0, 0.0)
STAY: Final[Move] = (1.2, 0.0, 0.0)
"""Long enough to see where the robot is, in spite of the navigation's correlated error."""
LONGEST_PIECE_S: Final = 2.5
ACROSS_S: Final = 5.0
MARGIN_M: Final = 0.4  # kept between the robot's centre and the edge of the room


@dataclass(frozen=True)
class Piece:
    """A piece with a readable name."""

    name: str
    manoeuvre: Manoeuvre


def of_moves(moves: Sequence[Move]) -> Manoeuvre:
    """Return the set-points of some moves, with the plant's signs."""
    seconds, left, right = (np.array(column) for column in zip(*moves, strict=True))
    at_s = np.round(np.concatenate([[0.0], np.cumsum(seconds)]), 3)
    return Manoeuvre(
        at_s[:-1], np.column_stack([left, left, -right, -right]), float(at_s[-1])
    )


def there_and_back(moves: Sequence[Move]) -> list[Move]:
    """Return moves, a pause, and the same way backwards."""
    back = [(s, -left, -right) for s, left, right in reversed(moves)]
    return [*moves, PAUSE, *back, PAUSE]


def pieces(robot: RobotParameters, room_m: tuple[float, float]) -> list[Piece]:
    """Return the pieces that stay inside a room when begun in its middle, along its first side.

    Parameters
    ----------
    room_m : tuple of float
        Sides of the room.
    """
    half = [0.5 * side - MARGIN_M for side in room_m]
    found = [
        Piece(name, of_moves(moves)) for name, moves in _all(robot, max(half[0], 0.05))
    ]
    paths = path_of([piece.manoeuvre for piece in found], robot)
    return [
        piece
        for piece, (x, y, _) in zip(found, paths, strict=True)
        if np.abs(x).max() <= half[0] and np.abs(y).max() <= half[1]
    ]


def _all(robot: RobotParameters, reach_m: float) -> Iterator[tuple[str, list[Move]]]:
    yield "stand still", [(2.0, 0.0, 0.0)]
    yield from _straights(robot, reach_m)
    yield from _spins(robot)
    yield from _arcs(robot, reach_m)
    yield from _steps(robot)


def _straights(
    robot: RobotParameters, reach_m: float
) -> Iterator[tuple[str, list[Move]]]:
    top, m_s = robot.max_rpm, robot.wheel_radius_m * RAD_S_PER_RPM
    for share in (0.25, 0.5, 0.85):
        rpm = share * top
        seconds = min(LONGEST_PIECE_S, 0.95 * reach_m / (rpm * m_s))
        yield (
            f"straight there and back, {rpm:.0f} rpm",
            there_and_back([(seconds, rpm, rpm)]),
        )
        across_s = 0.95 * reach_m / (rpm * m_s)
        if across_s <= ACROSS_S:
            there, back = (across_s, rpm, rpm), (across_s, -rpm, -rpm)
            legs = [back, STAY, there, there, STAY, back, PAUSE]
            yield f"straight across the room with stops, {rpm:.0f} rpm", legs
    parts = [(0.25, 0.8), (0.5, 0.6), (0.9, 0.5)]
    factor = min(1.0, 0.95 * reach_m / sum(share * top * m_s * s for share, s in parts))
    stairs = [(factor * s, share * top, share * top) for share, s in parts]
    yield "straight with changing speed, there and back", there_and_back(stairs)


def _spins(robot: RobotParameters) -> Iterator[tuple[str, list[Move]]]:
    top = robot.max_rpm
    for share, turn in ((0.15, 0.25), (0.35, 0.5), (0.35, 1.0), (0.7, 1.0)):
        rpm = share * top
        rad_s = 2.0 * robot.wheel_radius_m * rpm * RAD_S_PER_RPM * robot.k_om
        moves = [(turn * 2.0 * math.pi / rad_s, -rpm, rpm)]
        yield (
            f"{turn:g} {'turn' if turn == 1.0 else 'turns'} on the spot both ways, {rpm:.0f} rpm",
            there_and_back(moves),
        )
    slow, fast = 0.15 * top, 0.6 * top
    changing = [(0.7, -slow, slow), (0.7, -fast, fast), (0.7, -slow, slow)]
    yield "on the spot with changing speed, both ways", there_and_back(changing)
    rpm = 0.5 * top
    quick = [(0.4, -rpm, rpm), (0.8, rpm, -rpm), (0.4, -rpm, rpm)]
    yield "quick turns back and forth", [*quick, *quick, PAUSE]


def _arcs(robot: RobotParameters, reach_m: float) -> Iterator[tuple[str, list[Move]]]:
    top, m_s = robot.max_rpm, robot.wheel_radius_m * RAD_S_PER_RPM
    for share in (0.4, 0.85):
        for inner in (0.0, 0.4, 0.75):
            rpm = share * top
            seconds = min(
                LONGEST_PIECE_S, 0.95 * reach_m / (0.5 * (1.0 + inner) * rpm * m_s)
            )
            for side, move in _sides((seconds, inner * rpm, rpm)):
                name = (
                    f"{side} arc, {inner * rpm:.0f} and {rpm:.0f} rpm, there and back"
                )
                yield name, there_and_back([move])
    for share, inner in ((0.5, 0.2), (0.85, 0.4), (0.85, 0.65)):
        rpm = share * top
        rad_s = (1.0 - inner) * rpm * m_s * robot.k_om
        circle = (2.0 * math.pi / rad_s, inner * rpm, rpm)
        both = [move for _, move in _sides(circle)]
        yield (
            f"circle left, circle right, {rpm:.0f} rpm",
            [both[0], PAUSE, both[1], PAUSE],
        )
        for side, (seconds, left, right) in _sides(circle):
            fast = (0.6 * seconds, left, right)
            slow = (0.4 * seconds / 0.4, 0.4 * left, 0.4 * right)
            yield f"{side} circle at two speeds, {rpm:.0f} rpm", [slow, fast, PAUSE]
    slow_on, fast_on = (0.8, 0.1 * top, 0.3 * top), (0.8, 0.3 * top, 0.9 * top)
    for side, _ in _sides(slow_on):
        moves = [
            m if side == "left" else (m[0], m[2], m[1]) for m in (slow_on, fast_on)
        ]
        yield f"{side} arc with changing speed, there and back", there_and_back(moves)


def _sides(move: Move) -> list[tuple[str, Move]]:
    seconds, left, right = move
    return [("left", move), ("right", (seconds, right, left))]


def _steps(robot: RobotParameters) -> Iterator[tuple[str, list[Move]]]:
    top = robot.max_rpm
    launch = there_and_back([(0.5, 0.8 * top, 0.8 * top)])
    yield "rapid starts both ways", [*launch, *launch]
    full = [(0.4, top, top), (0.8, -top, -top), (0.4, top, top)]
    yield "full reversals that saturate", [*full, PAUSE]
    for rpm in (1.5, 4.0):
        creep = [(0.8, rpm, rpm), (0.8, -rpm, -rpm)]
        yield f"slow reversals, {rpm:g} rpm", [*creep, *creep, PAUSE]
    sizes = (5.0, 12.0, 25.0)
    small = [(0.4, sign * rpm, sign * rpm) for rpm in sizes for sign in (1.0, -1.0)]
    yield "small steps both ways", [*small, PAUSE]

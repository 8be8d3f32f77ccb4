"""What the robot is asked to do: lists of moves for the driver, tables of steps for the bench."""

import math

import numpy as np
from numpy.typing import NDArray

from hilserver_injector.pilot import DRIVE, GO_TO, HALL_M, SPIN, STOP

Array = NDArray[np.float64]
STEP_SLEW = 1e6
TOP_RPM = 90.0


def _move(
    kind: int,
    left: float,
    right: float,
    until: float,
    slew: float,
    rng: np.random.Generator,
) -> list[float]:
    x, y = rng.uniform(-0.7 * HALL_M, 0.7 * HALL_M, 2)
    return [kind, left, right, until, slew, x, y]


def _slew(rng: np.random.Generator) -> float:
    return STEP_SLEW if rng.random() < 0.6 else float(rng.uniform(60.0, 400.0))


def _straight(rng: np.random.Generator) -> list[list[float]]:
    """One to three speeds in one direction, up to the top speed."""
    sign = rng.choice([-1.0, 1.0], p=[0.35, 0.65])
    moves = []
    for _ in range(int(rng.integers(1, 4))):
        rpm = sign * rng.choice([rng.uniform(15, 60), rng.uniform(62, TOP_RPM)])
        moves.append(_move(DRIVE, rpm, rpm, rng.uniform(1.0, 4.0), _slew(rng), rng))
    return moves


def _arc(rng: np.random.Generator) -> list[list[float]]:
    """One side slower than the other, down to standing still."""
    outer = rng.uniform(25.0, TOP_RPM) * rng.choice([-1.0, 1.0], p=[0.35, 0.65])
    inner = outer * rng.uniform(0.0, 0.9)
    left, right = (outer, inner) if rng.random() < 0.5 else (inner, outer)
    return [_move(DRIVE, left, right, rng.uniform(2.0, 6.0), _slew(rng), rng)]


def _spin(rng: np.random.Generator) -> list[list[float]]:
    rpm = rng.uniform(12.0, 60.0) * rng.choice([-1.0, 1.0])
    return [_move(SPIN, -rpm, rpm, rng.uniform(0.5, 2.5 * math.pi), _slew(rng), rng)]


def _visit(rng: np.random.Generator) -> list[list[float]]:
    move = _move(
        GO_TO, rng.uniform(30.0, 85.0), rng.uniform(20.0, 45.0), 0.0, _slew(rng), rng
    )
    move[5], move[6] = rng.uniform(-HALL_M, HALL_M, 2)
    return [move]


def mixed(rng: np.random.Generator, duration_s: float) -> Array:
    """Return moves for a drive with everything in it, more than the duration takes."""
    moves: list[list[float]] = [
        _move(STOP, 0, 0, rng.uniform(0.5, 1.5), STEP_SLEW, rng)
    ]
    kinds = (_straight, _arc, _spin, _visit)
    while len(moves) < 20 + duration_s:
        for pick in rng.permutation(len(kinds)):
            moves += kinds[pick](rng)
            if rng.random() < 0.3:
                moves.append(_move(STOP, 0, 0, rng.uniform(0.3, 1.5), _slew(rng), rng))
    return np.array(moves)


def spins(rng: np.random.Generator, duration_s: float) -> Array:
    """Return turns on the spot, both ways, at different speeds."""
    moves = [_move(STOP, 0, 0, 1.0, STEP_SLEW, rng)]
    while len(moves) < 20 + duration_s:
        rpm = rng.uniform(10.0, 60.0) * rng.choice([-1.0, 1.0])
        moves.append(_move(SPIN, -rpm, rpm, rng.uniform(2.0, 9.0), STEP_SLEW, rng))
        moves.append(_move(STOP, 0, 0, rng.uniform(0.3, 1.0), STEP_SLEW, rng))
    return np.array(moves)


def straights(rng: np.random.Generator, duration_s: float) -> Array:
    """Return long straight legs through the hall, with stops and turns between them."""
    moves = [_move(STOP, 0, 0, 1.0, STEP_SLEW, rng)]
    while len(moves) < 20 + duration_s:
        moves += _visit(rng)
        rpm = rng.uniform(30.0, TOP_RPM) * rng.choice([-1.0, 1.0])
        moves.append(_move(DRIVE, rpm, rpm, rng.uniform(3.0, 9.0), _slew(rng), rng))
        moves.append(_move(STOP, 0, 0, rng.uniform(0.3, 1.0), STEP_SLEW, rng))
    return np.array(moves)


def circles(rng: np.random.Generator, duration_s: float) -> Array:
    """Return circles of four radii, the last one on the inner wheels standing still."""
    moves = [_move(STOP, 0, 0, 1.0, STEP_SLEW, rng)]
    while len(moves) < 20 + duration_s:
        for share in rng.permutation([0.75, 0.5, 0.25, 0.0]):
            outer = rng.uniform(40.0, 80.0)
            left, right = (outer, outer * share)[:: int(rng.choice([-1, 1]))]
            moves.append(
                _move(DRIVE, left, right, rng.uniform(5.0, 9.0), STEP_SLEW, rng)
            )
            if rng.random() < 0.5:
                moves += _visit(rng)
    return np.array(moves)


def launches(rng: np.random.Generator, duration_s: float) -> Array:
    """Return hard starts and stops of straight legs, some of them gentle."""
    moves = [_move(STOP, 0, 0, 1.0, STEP_SLEW, rng)]
    while len(moves) < 20 + 2 * duration_s:
        rpm = rng.uniform(40.0, TOP_RPM) * rng.choice([-1.0, 1.0])
        slew = STEP_SLEW if rng.random() < 0.7 else float(rng.uniform(40.0, 120.0))
        moves.append(_move(DRIVE, rpm, rpm, rng.uniform(0.5, 1.5), slew, rng))
        moves.append(_move(STOP, 0, 0, rng.uniform(0.3, 0.8), slew, rng))
        if rng.random() < 0.3:
            moves += _spin(rng)
    return np.array(moves)


def fast(rng: np.random.Generator, duration_s: float) -> Array:
    """Return straight legs and arcs at 62 to 90 rpm and turns of whole circles, all steps."""
    moves = [_move(STOP, 0, 0, 1.0, STEP_SLEW, rng)]
    while len(moves) < 20 + duration_s:
        rpm = rng.uniform(62.0, TOP_RPM) * rng.choice([-1.0, 1.0])
        share = rng.choice([1.0, rng.uniform(0.7, 0.95)])
        left, right = (rpm, rpm * share)[:: int(rng.choice([-1, 1]))]
        moves.append(_move(DRIVE, left, right, rng.uniform(1.5, 4.0), STEP_SLEW, rng))
        moves.append(_move(STOP, 0, 0, rng.uniform(0.5, 1.5), STEP_SLEW, rng))
        rpm = rng.uniform(62.0, TOP_RPM) * rng.choice([-1.0, 1.0])
        moves.append(_move(SPIN, -rpm, rpm, rng.uniform(3.0, 9.0), STEP_SLEW, rng))
        moves.append(_move(STOP, 0, 0, rng.uniform(0.5, 1.0), STEP_SLEW, rng))
    return np.array(moves)


def ramps(rng: np.random.Generator, duration_s: float) -> Array:
    """Return a mixed drive whose set-points move on ramps."""
    moves = mixed(rng, duration_s)
    moves[:, 4] = rng.uniform(40.0, 200.0, len(moves))
    return moves


DRIVES = {
    "fast": fast,
    "ramps": ramps,
    "mixed": mixed,
    "spins": spins,
    "straights": straights,
    "circles": circles,
    "launches": launches,
}


def _level(rng: np.random.Generator, now: float) -> float:
    """Return the next level of a bench: far steps, small steps, creeping, reversals, standstill."""
    pick = rng.random()
    if pick < 0.30:
        return float(rng.uniform(20.0, TOP_RPM) * rng.choice([-1.0, 1.0]))
    if pick < 0.50:
        return float(
            np.clip(now + rng.uniform(1.0, 5.0) * rng.choice([-1.0, 1.0]), -90.0, 90.0)
        )
    if pick < 0.65:
        return float(rng.uniform(0.3, 5.0) * rng.choice([-1.0, 1.0]))
    if pick < 0.85:
        return -now
    return 0.0


def steps(rng: np.random.Generator, times: Array) -> Array:
    """Return set-points [rpm] of a bench, shape (n, 4): plateaus of 0.2 to 2 s, some ramps."""
    table = np.zeros((len(times), 4))
    together = rng.random() < 0.5
    for group in ([0, 1, 2, 3],) if together else ([0], [1], [2], [3]):
        at, now = float(rng.uniform(0.3, 0.8)), 0.0
        while at < times[-1]:
            lasts, level = float(rng.uniform(0.2, 2.0)), _level(rng, now)
            inside = (times >= at) & (times < at + lasts)
            shape = np.full(int(inside.sum()), level)
            if rng.random() < 0.15:
                shape = np.linspace(now, level, len(shape))
            for wheel in group:
                table[inside, wheel] = shape if wheel < 2 else -shape
            at, now = at + lasts, level
    return table


def small_steps(rng: np.random.Generator, times: Array) -> Array:
    """Return steps below 5 rpm around one level, which never saturate."""
    level = rng.uniform(20.0, 50.0)
    table, at = np.zeros((len(times), 4)), 1.0
    ramp = np.clip(times, 0.0, 1.0) * level
    table[:] = ramp[:, None]
    while at < times[-1]:
        lasts = float(rng.uniform(0.3, 1.5))
        inside = (times >= at) & (times < at + lasts)
        table[inside] = level + rng.uniform(-2.4, 2.4)
        at += lasts
    return table * np.array([1.0, 1.0, -1.0, -1.0])


def flat_out(rng: np.random.Generator, times: Array) -> Array:
    """Return reversals near the top speed: a weak drive is at its limit all the time."""
    table, at, sign = np.zeros((len(times), 4)), 1.0, 1.0
    while at < times[-1]:
        lasts = float(rng.uniform(0.3, 1.5))
        inside = (times >= at) & (times < at + lasts)
        table[inside] = sign * rng.uniform(0.93, 1.0) * TOP_RPM
        at, sign = at + lasts, -sign
    return table * np.array([1.0, 1.0, -1.0, -1.0])


def one_way(rng: np.random.Generator, times: Array) -> Array:
    """Return plateaus and gentle ramps in one direction: the drive never brakes."""
    knots, levels = [0.0, 0.5, 1.5], [0.0, 0.0, 30.0]
    while knots[-1] < times[-1]:
        level = float(rng.uniform(15.0, 60.0))
        knots += [knots[-1] + abs(level - levels[-1]) / 40.0, 0.0]
        knots[-1] = knots[-2] + float(rng.uniform(0.3, 1.5))
        levels += [level, level]
    table = np.repeat(np.interp(times, knots, levels)[:, None], 4, axis=1)
    return table * np.array([1.0, 1.0, -1.0, -1.0])


BENCHES = {
    "mixed": steps,
    "small_steps": small_steps,
    "flat_out": flat_out,
    "one_way": one_way,
}

OF_WHEELS = np.array(
    [[1.0, -1.0, -1.0], [1.0, 1.0, -1.0], [-1.0, -1.0, -1.0], [-1.0, 1.0, -1.0]]
)
"""Mecanum wheels fl, rl, fr, rr by what each of ahead, left and turning left asks of them."""


def _twist(rng: np.random.Generator) -> Array:
    """Return wheel speeds [rpm] for ahead, left and turning, of which one to three are there."""
    parts = rng.uniform(-1.0, 1.0, 3) * (rng.random(3) < (0.6, 0.6, 0.3))
    if not parts.any():
        parts[int(rng.integers(0, 3))] = 1.0
    return np.asarray(parts / np.abs(parts).sum() * rng.uniform(40.0, TOP_RPM))


def omni(rng: np.random.Generator, times: Array) -> Array:
    """Return a drive on mecanum wheels: ahead, to the sides and turning, there and back again."""
    table, at = np.zeros((len(times), 4)), 1.0
    while at < times[-1]:
        legs = [
            (_twist(rng), rng.uniform(3.0, 8.0)) for _ in range(int(rng.integers(1, 3)))
        ]
        back = [(-rpm, lasts) for rpm, lasts in reversed(legs)]
        turn = np.array([0.0, 0.0, rng.uniform(-60.0, 60.0)]), rng.uniform(0.5, 3.0)
        rest = np.zeros(3), rng.uniform(0.3, 1.0)
        for rpm, lasts in (*legs, *back, turn, rest):
            table[(times >= at) & (times < at + lasts)] = OF_WHEELS @ rpm
            at += lasts
    return table


TABLES = {"omni": omni}
"""Drives that follow a table, wherever that leads."""

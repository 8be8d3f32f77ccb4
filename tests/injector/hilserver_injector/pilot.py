"""The driver: works off a list of moves, looks at the true pose and stays in the hall."""

import math
from typing import Any

from hilserver_injector.compiled import kernel

STOP, DRIVE, SPIN, GO_TO = 0, 1, 2, 3
KIND, LEFT, RIGHT, UNTIL, SLEW, TO_X, TO_Y = range(7)
"""Columns of a move: rim speeds [rpm, forward positive], end (s, or rad for SPIN), rpm/s, point."""

MOVE, SINCE, TURNED, LAST_YAW, PHASE, RETURN, WANT_L, WANT_R = range(8)
N_PILOT = 8
HALL_M = 4.6
NEAR_M = 0.35
AIM_RAD = 0.06
LONGEST_S = 25.0


@kernel
def wrapped(angle: float) -> float:
    """Return the angle within -pi .. pi."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@kernel
def _go_to(s: Any, move: Any, t: float, x: float, y: float, yaw: float) -> bool:
    """Turn towards the point, then drive to it; returns whether it is reached."""
    ahead, aside = move[TO_X] - x, move[TO_Y] - y
    error = wrapped(math.atan2(aside, ahead) - yaw)
    if s[PHASE] == 0.0:
        speed = abs(move[RIGHT])
        if abs(error) < 0.6:
            speed = min(speed, 18.0)
        if abs(error) < AIM_RAD:
            s[PHASE] = 1.0
            s[WANT_L] = s[WANT_R] = 0.0
            return False
        s[WANT_R] = math.copysign(speed, error)
        s[WANT_L] = -s[WANT_R]
        return False
    s[WANT_L] = s[WANT_R] = abs(move[LEFT])
    return math.hypot(ahead, aside) < NEAR_M or abs(error) > 1.2


@kernel
def drive(s: Any, moves: Any, t: float, x: float, y: float, yaw: float) -> None:
    """Decide what the wheels should do from now on; `s` is the driver's memory."""
    move = moves[int(s[MOVE])]
    s[TURNED] += wrapped(yaw - s[LAST_YAW])
    s[LAST_YAW] = yaw
    lasted = t - s[SINCE]
    done = lasted > LONGEST_S
    if s[RETURN] == 1.0 or move[KIND] == GO_TO:
        done = done or _go_to(s, move, t, x, y, yaw)
    elif move[KIND] == SPIN:
        s[WANT_L], s[WANT_R] = move[LEFT], move[RIGHT]
        done = done or abs(s[TURNED]) >= move[UNTIL]
    else:
        s[WANT_L], s[WANT_R] = move[LEFT], move[RIGHT]
        done = done or lasted >= move[UNTIL]
        forward = move[LEFT] + move[RIGHT]
        vx, vy = forward * math.cos(yaw), forward * math.sin(yaw)
        outwards = (x > HALL_M and vx > 0.0) or (x < -HALL_M and vx < 0.0)
        outwards = outwards or (y > HALL_M and vy > 0.0) or (y < -HALL_M and vy < 0.0)
        if outwards:
            s[RETURN], s[PHASE], s[SINCE], s[TURNED] = 1.0, 0.0, t, 0.0
            s[WANT_L] = s[WANT_R] = 0.0
            return
    if done:
        s[MOVE] = (s[MOVE] + 1.0) % moves.shape[0]
        s[SINCE], s[TURNED], s[PHASE], s[RETURN] = t, 0.0, 0.0, 0.0
        kind = moves[int(s[MOVE])][KIND]
        if kind in (STOP, GO_TO):
            s[WANT_L] = s[WANT_R] = 0.0


@kernel
def towards(now: float, wanted: float, most: float) -> float:
    """Return the next set-point on a ramp."""
    return min(max(wanted, now - most), now + most)

"""The filter: processes one moment after another, and late samples at the moment they belong to.

A sample older than the newest moment is assigned to its own moment, and all later moments are
computed again, so that the estimate is that of a filter without latency.
"""

import math
from typing import Any

from hilserver.compiled import inlined, part
from hilserver.compiled.records import record_at
from hilserver.observer.correction import begin, take_gyro, take_position, take_yaw
from hilserver.observer.layout import (
    FIGURES,
    HEAD,
    HEADING,
    MOMENT,
    MOMENTS,
    N_HEAD,
    N_MOMENT,
    OLDEST_S,
    PLACE,
    Moment,
)
from hilserver.observer.motion import bend, predict, rolling
from hilserver.plant.layout import Parameters

_SAME_S = 1e-9


@inlined
def moment(f: Any, age: int) -> Any:
    """Return the moment `age` steps before the newest."""
    row = (int(record_at(f, 0, HEAD).newest) - age) % MOMENTS
    return record_at(f, N_HEAD + row * N_MOMENT, MOMENT)


@inlined
def read(m: Moment, time: float, wheels: Any) -> None:
    """Write the time of a moment [s] and its wheel readings, as in `open_moment`."""
    m.time, m.left, m.right, m.angle_left = time, wheels[0], wheels[1], wheels[2]
    m.apart_left, m.apart_right = wheels[3], wheels[4]


@part
def open_moment(c: Any, f: Any, time: float, wheels: Any) -> None:
    """Begin a moment at a time [s].

    Parameters
    ----------
    wheels : sequence of float
        Mean speeds of both sides [rad/s], angle of the left wheels [rad], and front minus rear
        wheel of both sides [rad/s].
    """
    h = record_at(f, 0, HEAD)
    if h.count > 0.0:
        h.newest = (h.newest + 1.0) % MOMENTS
    h.count = min(h.count + 1.0, MOMENTS)
    h.redo = 0.0
    m = moment(f, 0)
    read(m, time, wheels)
    m.has_gyro = m.has_position = m.has_yaw = m.turning = m.bend_left = m.bend_right = (
        0.0
    )
    if h.count > 2.0:
        older = moment(f, 2)
        bend(older.time, older.left, older.right, moment(f, 1), m)
    if h.count == 1.0:
        m.last_fix = m.misfit = 0.0
        for kind in (PLACE, HEADING):
            m.fixed[kind] = m.refused[kind] = m.agreeing[kind] = m.rolled[kind] = 0.0
            m.came[kind] = time
        begin(record_at(c, 0, FIGURES), m)


@part
def age_of(f: Any, time: float) -> int:
    """Return how many steps back a sample's moment is: the first moment that is not before it.

    -1 if it is too old, which is counted, or newer than the newest moment.
    """
    h = record_at(f, 0, HEAD)
    newest = moment(f, 0).time
    if time > newest + _SAME_S:
        return -1
    age, last = 0, int(h.count) - 1
    while age < last and moment(f, age + 1).time >= time - _SAME_S:
        age += 1
    if newest - time > OLDEST_S or (age == last and last > 0):
        h.late += 1.0
        return -1
    h.redo = max(h.redo, float(age))
    return age


@inlined
def add_gyro(f: Any, time: float, rate: float) -> None:
    """Add a gyro reading [rad/s] of a time [s]."""
    age = age_of(f, time)
    if age >= 0:
        m = moment(f, age)
        m.has_gyro, m.gyro_back, m.gyro = 1.0, m.time - time, rate


@inlined
def add_position(f: Any, time: float, x: float, y: float) -> None:
    """Add a position of the tag [m] of a time [s]."""
    age = age_of(f, time)
    if age >= 0:
        m = moment(f, age)
        m.has_position, m.position_back = 1.0, m.time - time
        m.position[0], m.position[1] = x, y


@inlined
def add_yaw(f: Any, time: float, yaw: float) -> None:
    """Add a heading of the tag [rad] of a time [s]."""
    age = age_of(f, time)
    if age >= 0:
        m = moment(f, age)
        m.has_yaw, m.yaw_back, m.yaw = 1.0, m.time - time, yaw


@inlined
def remember(p: Parameters, before: Moment, now: Moment) -> None:
    """Take over from the moment before what samples have shown until then."""
    way = rolling(p, now) * (now.time - before.time)
    for kind in (PLACE, HEADING):
        now.fixed[kind] = before.fixed[kind]
        now.refused[kind] = before.refused[kind]
        now.agreeing[kind] = before.agreeing[kind]
        now.came[kind] = before.came[kind]
        now.reach[kind] = before.reach[kind]
        now.rolled[kind] = before.rolled[kind]
        now.rolled_before[kind] = before.rolled_before[kind]
    for i in range(now.off.shape[0]):
        now.off[i] = before.off[i]
    now.rolled[PLACE] += way
    now.rolled[HEADING] += 2.0 * abs(p.yaw_gain) * way
    now.last_fix = before.last_fix
    now.nis = before.nis
    now.misfit = before.misfit


@part
def close_moment(p: Parameters, c: Any, f: Any) -> None:
    """Compute the newest moment, after recomputing those that a late sample changed."""
    h = record_at(f, 0, HEAD)
    for age in range(int(h.redo), -1, -1):
        now = moment(f, age)
        dt = 1.0
        if age < int(h.count) - 1:
            before = moment(f, age + 1)
            dt = now.time - before.time
            predict(p, c, h, before, now)
            remember(p, before, now)
        now.carried = 0.0
        now.surprise[PLACE] = now.surprise[HEADING] = math.nan
        if now.has_gyro != 0.0:
            take_gyro(p, c, h, now, dt)
        if now.has_yaw != 0.0:
            take_yaw(p, c, h, now, now.has_yaw == 1.0)
            now.has_yaw = 2.0
        if now.has_position != 0.0:
            take_position(p, c, h, now, now.has_position == 1.0)
            now.has_position = 2.0
    h.redo = 0.0

"""Structure that the library does not have: what the remaining error depends on, without a name.

What is left is mapped against the regressors that are at hand: time, place, heading, speed, turn
rate, history, the other wheels. A family of columns stands for each; a family is a disturbance of
the body velocity (pose) or of speed and duty (drive) that depends on its regressor alone.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import singledispatch

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.regression.disturbance import Motion
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.replay.drive_stage import DriveStage
from hilserver.diagnosis.replay.pose_stage import PoseStage
from hilserver.diagnosis.replay.stage import Stage
from hilserver.measured.channels import DUTIES, GYRO, POSITION, SPEEDS, YAW
from hilserver.plant.layout import WHEELS
from hilserver.plant.units import RAD_S_PER_RPM

DRIVES, TURNS = 0.1, 0.1  # speed [m/s] and turn rate [rad/s] from which a direction is remembered
TURNING, DRIVING = 0.2, 0.05  # turn rate [rad/s] and speed [m/s] from which a direction counts
RANGING = "ranging"
FREQUENCIES_HZ = tuple(float(f) for f in np.geomspace(0.02, 2.0, 9))
PEAKS, FINEST_HZ = 3, 5.0
ANCHORS_OUTSIDE = 0.1
"""How far outside of the driven place ranging anchors are taken to stand, by its width."""


@dataclass(frozen=True)
class Family:
    """Columns that depend on one regressor."""

    name: str
    regressors: tuple[str, ...]  # signals, or ``t_s``, strongest first
    columns: Array  # shape (n, k): raw, per unit of an arbitrary coefficient


@singledispatch
def families(stage: Stage, problem: Problem, point: Point) -> Iterable[Family]:
    """Return what a disturbance of what a stage replays could depend on."""
    raise NotImplementedError(f"no structure of a {stage.name} is known")


@families.register
def _(stage: PoseStage, problem: Problem, point: Point) -> list[Family]:
    """Return what a disturbance of the body's velocity could depend on."""
    m = Motion(stage, problem, point)
    zero, v, om = np.zeros_like(m.v), m.v, m.om
    on = m.moving

    def family(name: str, regressors: Sequence[str], shapes: Sequence[Array]) -> Family:
        columns = []
        for shape in shapes:
            columns.append(m.column(shape * v, zero, zero))
            columns.append(m.column(zero, zero, shape * om))
        return Family(name, tuple(regressors), np.stack(columns, axis=1))

    heading = [f(k * m.yaw) for k in (1, 2) for f in (np.cos, np.sin)]
    place_x, place_y = _unit(m.x), _unit(m.y)
    found = []
    signal = YAW if YAW in problem.stack.edges else "pose.yaw_rad"
    columns = [m.column(*d) for h in heading for d in
               ((h * on, zero, zero), (zero, h * on, zero), (zero, zero, h * on),
                (h * v, zero, zero), (zero, h * v, zero), (zero, zero, h * np.abs(v)),
                (zero, zero, h * om))]  # fmt: skip
    if not m.stage.begins_anew:
        found.append(Family("heading", (signal, "pose.yaw_rad"), np.stack(columns, axis=1)))
    if POSITION[0] in problem.stack.edges and not m.stage.begins_anew:
        shapes = [place_x, place_y, place_x**2, place_y**2, place_x * place_y,
                  np.sin(np.pi * place_x), np.sin(np.pi * place_y)]  # fmt: skip
        found.append(family("place", POSITION, shapes))
        found.append(_ranging(m))
    size, spin = np.abs(v) / (np.abs(v).max() + 1e-9), np.abs(om) / (np.abs(om).max() + 1e-9)
    speed = [m.column(zero, zero, size * on * _side(om, TURNING)), m.column(size * v, zero, zero),
             m.column(size**2 * v, zero, zero), m.column(zero, size * v, zero),
             m.column(zero, zero, v), m.column(zero, zero, size * v),
             m.column(zero, zero, size**2 * om),
             m.column(_side(v, DRIVING), zero, zero)]  # fmt: skip
    found.append(Family("speed", ("velocity.linear_m_s",), np.stack(speed, axis=1)))
    turn = [m.column(zero, zero, spin * om), m.column(zero, zero, spin**2 * om),
            m.column(spin**2 * v, zero, zero), m.column(zero, spin * om, zero),
            m.column(om, zero, zero), m.column(np.abs(om), zero, zero),
            m.column(zero, zero, np.abs(om)), m.column(zero, np.abs(om), zero),
            m.column(zero, zero, _side(om, TURNING))]  # fmt: skip
    found.append(Family("turn", ("velocity.angular_rad_s",), np.stack(turn, axis=1)))
    went, turned = m.last_side(v, DRIVES), m.last_side(om, TURNS)
    driven = [m.column(zero, zero, went * om), m.column(went * v, zero, zero)]
    spun = [m.column(turned * v, zero, zero), m.column(zero, zero, turned * om)]
    for tau_s in (0.3, 1.0, 3.0):
        past_v, past_om = m.smoothed(v, tau_s), m.smoothed(om, tau_s)
        driven += [m.column(past_v - v, zero, zero),
                   m.column(_side(past_v, DRIVING) * on, zero, zero),
                   m.column(_side(past_v, DRIVING) * np.abs(v), zero, zero)]  # fmt: skip
        spun += [m.column(zero, zero, past_om - om),
                 m.column(zero, zero, _side(past_om, TURNING) * on),
                 m.column(zero, zero, _side(past_om, TURNING) * np.abs(om))]  # fmt: skip
    names = ("velocity.linear_m_s", "wheels.speeds_rpm")
    found.append(Family("history of the speed", names, np.stack(driven, axis=1)))
    names = ("velocity.angular_rad_s", "wheels.speeds_rpm")
    found.append(Family("history of the turn", names, np.stack(spun, axis=1)))
    strongest = () if GYRO not in problem.stack.edges else peaks(problem, point, (GYRO,))
    found.append(_periodic_pose(m, strongest))
    return found


def anchor_fields(m: Motion) -> Array:
    """Return how the position moves where one of four ranging anchors measures too long.

    Shape (4, n, 2), metre per metre. Where the anchors are is unknown: they are assumed
    about the place where the robot drove, from low x and y on against the clock. Least squares of
    the four ranges moves by ``(H'H)^-1 H' e``, H the directions to them.
    """
    low = np.array([m.x.min(), m.y.min()])
    high = np.array([m.x.max(), m.y.max()])
    margin = ANCHORS_OUTSIDE * (high - low) + 0.5
    (x0, y0), (x1, y1) = low - margin, high + margin
    anchors = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    away = np.stack([m.x, m.y], axis=1)[:, None, :] - anchors
    away = away / np.linalg.norm(away, axis=2, keepdims=True)
    normal = np.linalg.inv(np.einsum("nki,nkj->nij", away, away))
    return np.asarray(np.einsum("nij,nkj->kni", normal, away))


def _ranging(m: Motion) -> Family:
    columns = [m.placed(*field.T) for field in anchor_fields(m)]
    return Family(RANGING, POSITION, np.stack(columns, axis=1))


def peaks(problem: Problem, point: Point, names: Sequence[str]) -> tuple[float, ...]:
    """Return the frequencies [Hz] at which the residual of some channels is strongest."""
    residual, stack = problem.residual(point.predicted), problem.stack
    courses = []
    for name in names:
        t, r = stack.t_s[stack.edges[name]], residual[stack.edges[name]]
        if len(t) < 200 or t[-1] <= t[0]:
            continue
        grid = np.arange(t[0], t[-1], 0.5 / FINEST_HZ)
        total = np.concatenate([[0.0], np.cumsum(r)])
        edges = np.searchsorted(t, np.append(grid, t[-1]))
        even = (total[edges[1:]] - total[edges[:-1]]) / np.maximum(np.diff(edges), 1)
        courses.append(even - even.mean())
    if not courses:
        return ()
    padded = 4 * max(map(len, courses))  # a channel may end before the others
    power = np.sum([np.abs(np.fft.rfft(course, padded)) ** 2 for course in courses], axis=0)
    step_hz, width = FINEST_HZ / (len(power) - 1), 6
    out = []
    for _ in range(PEAKS):
        k = int(np.argmax(power))
        out.append(max(k, 1) * step_hz)
        power[max(k - width, 0) : k + width + 1] = 0.0
    return tuple(out)


def _periodic_pose(m: Motion, found: Sequence[float]) -> Family:
    zero, columns = np.zeros_like(m.v), []
    for f in (*found, *FREQUENCIES_HZ):
        for wave in (np.cos, np.sin):
            shape = wave(2.0 * np.pi * f * m.t)
            columns.append(m.column(zero, zero, shape * m.moving))
            columns.append(m.column(shape * m.moving, zero, zero))
    return Family("time", ("t_s",), np.stack(columns, axis=1))


def _side(values: Array, knee: float) -> Array:
    """Return the sign of a signal, smooth at zero, where a sharp one would follow the noise."""
    return np.asarray(np.tanh(values / knee))


def _unit(values: Array) -> Array:
    low, high = np.quantile(values, [0.01, 0.99])
    return np.asarray(np.clip((2.0 * values - low - high) / max(high - low, 1e-9), -1.5, 1.5))


@families.register
def _(stage: DriveStage, problem: Problem, point: Point) -> Iterator[Family]:
    """Return what a disturbance of speed and duty could depend on."""
    stack = problem.stack
    _, seen, duty = stage.simulate(point.model.terms)
    rate = 1.0 / stage.segments.period_s
    slope = np.gradient(seen, axis=0) * rate
    angle = np.cumsum(seen, axis=0) * (RAD_S_PER_RPM / rate)
    t = np.concatenate([stage.segments.times(i) for i in range(len(stage.segments))])

    def of_wheel(w: int, speed: Array | None, work: Array | None) -> Array:
        """Column of one wheel: what is added to its speed and its duty."""
        column = np.zeros(len(stack))
        for name, dense in ((SPEEDS[w], speed), (DUTIES[w], work)):
            if dense is not None and name in stack.edges:
                edge = stack.edges[name]
                column[edge] = dense[np.rint(stack.at[edge]).astype(np.int64)]
        return column

    def disturbed(wheels: Sequence[int], shape: Array) -> list[Array]:
        """Columns of a load that needs `shape` more duty: the loop answers, the speed dips."""
        dip = -np.gradient(shape) * rate * 0.005
        return [
            np.sum([of_wheel(w, None, shape) for w in wheels], axis=0),
            np.sum([of_wheel(w, dip, None) for w in wheels], axis=0),
        ]

    for source in range(4):
        columns = []
        for w in range(4):
            if w == source:
                continue
            columns += [of_wheel(w, seen[:, source], duty[:, source])]
            columns += disturbed((w,), seen[:, source])
            columns += disturbed((w,), slope[:, source] / 100.0)
        name = WHEELS[source]
        yield (
            Family(
                f"wheel {name}",
                (f"wheel.{name}.setpoint_rpm", f"wheel.{name}.speed_rpm", f"wheel.{name}.duty_pct"),
                np.stack(columns, axis=1),
            )
        )
    for w in range(4):
        columns = []
        for k in (1, 2):
            for wave in (np.cos, np.sin):
                columns += disturbed((w,), wave(k * angle[:, w]))
        yield (
            Family(
                f"angle {WHEELS[w]}", (f"wheel.{WHEELS[w]}.angle_rad",), np.stack(columns, axis=1)
            )
        )
    columns = []
    duties = [n for n in DUTIES if n in stack.edges]
    found = peaks(problem, point, duties or [n for n in SPEEDS if n in stack.edges])
    for f in (*found, *FREQUENCIES_HZ):
        for wave in (np.cos, np.sin):
            columns += disturbed(range(4), wave(2.0 * np.pi * f * t))[:1]
    yield (Family("time", ("t_s",), np.stack(columns, axis=1)))
    columns = []
    for w in range(4):
        n = seen[:, w]
        for shape in (n * np.abs(n) / 60.0, n**3 / 3600.0, np.abs(n)):
            columns += disturbed((w,), shape)[:1]
    yield (Family("speed", SPEEDS, np.stack(columns, axis=1)))

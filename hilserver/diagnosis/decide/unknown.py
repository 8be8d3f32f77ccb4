"""Structure that the library does not have: what the remaining error depends on, without a name.

What is left is mapped against the available regressors: time, place, heading, speed, turn rate,
history, the other wheels. Each has a family of columns: a disturbance of the body velocity (pose)
or of speed and duty (drive) that depends on that regressor alone.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.regression.disturbance import Motion
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.replay.drive_stage import DriveStage
from hilserver.diagnosis.replay.pose_stage import PoseStage
from hilserver.diagnosis.thresholds import ANCHORS_OUTSIDE
from hilserver.measured.channels import DUTIES, GYRO, POSITION, SPEEDS, YAW
from hilserver.plant.layout import WHEELS
from hilserver.plant.units import RAD_S_PER_RPM

# speed [m/s] and turn rate [rad/s] from which a direction is remembered
DRIVES, TURNS = 0.1, 0.1
# turn rate [rad/s] and speed [m/s] from which a direction counts
TURNING, DRIVING = 0.2, 0.05
RANGING = "ranging"
FREQUENCIES_HZ = tuple(float(f) for f in np.geomspace(0.02, 2.0, 9))
PEAKS, FINEST_HZ = 3, 5.0

Raw = tuple[str, tuple[str, ...], list[Array]]
"""A family with its raw columns, per unit of an arbitrary coefficient."""


@dataclass(frozen=True)
class Family:
    """Columns that depend on one regressor."""

    name: str
    regressors: tuple[str, ...]  # signals, or ``t_s``, strongest first
    white: Array  # shape (n, k): columns, whitened, initial poses projected out


def families_of(problem: Problem, point: Point) -> Iterator[Family]:
    """Yield the families on which a disturbance of a stage could depend."""
    stage = problem.stage
    if isinstance(stage, PoseStage):
        found = _of_the_body(Motion(stage, problem, point), problem, point)
    else:
        assert isinstance(stage, DriveStage)
        found = _of_the_drive(stage, problem, point)
    for name, regressors, columns in found:
        yield Family(name, regressors, problem.shown(point, np.stack(columns, axis=1)))


def _of_the_body(m: Motion, problem: Problem, point: Point) -> Iterator[Raw]:
    """Yield the families on which a disturbance of the body's velocity could depend."""
    v, om, on, edges = m.v, m.om, m.moving, problem.stack.edges
    ahead, aside, turn = m.ahead, m.aside, m.turn
    if not m.stage.begins_anew:
        waves = [f(k * m.yaw) for k in (1, 2) for f in (np.cos, np.sin)]
        columns = [c for h in waves for c in (
            ahead(h * on), aside(h * on), turn(h * on), ahead(h * v), aside(h * v),
            turn(h * np.abs(v)), turn(h * om),
        )]  # fmt: skip
        yield (
            "heading",
            (YAW if YAW in edges else "pose.yaw_rad", "pose.yaw_rad"),
            columns,
        )
    if POSITION[0] in edges and not m.stage.begins_anew:
        x, y = _unit(m.x), _unit(m.y)
        shapes = (x, y, x**2, y**2, x * y, np.sin(np.pi * x), np.sin(np.pi * y))
        yield (
            "place",
            POSITION,
            [c for h in shapes for c in (ahead(h * v), turn(h * om))],
        )
        yield RANGING, POSITION, [m.placed(*field.T) for field in anchor_fields(m)]
    size, spin = (
        np.abs(v) / (np.abs(v).max() + 1e-9),
        np.abs(om) / (np.abs(om).max() + 1e-9),
    )
    yield "speed", ("velocity.linear_m_s",), [
        turn(size * on * _side(om, TURNING)), ahead(size * v), ahead(size**2 * v), aside(size * v),
        turn(v), turn(size * v), turn(size**2 * om), ahead(_side(v, DRIVING)),
    ]  # fmt: skip
    yield "turn", ("velocity.angular_rad_s",), [
        turn(spin * om), turn(spin**2 * om), ahead(spin**2 * v), aside(spin * om), ahead(om),
        ahead(np.abs(om)), turn(np.abs(om)), aside(np.abs(om)), turn(_side(om, TURNING)),
    ]  # fmt: skip
    went, turned = m.last_side(v, DRIVES), m.last_side(om, TURNS)
    driven, spun = (
        [turn(went * om), ahead(went * v)],
        [ahead(turned * v), turn(turned * om)],
    )
    for tau_s in (0.3, 1.0, 3.0):
        past, past_om = m.smoothed(v, tau_s), m.smoothed(om, tau_s)
        side, side_om = _side(past, DRIVING), _side(past_om, TURNING)
        driven += [ahead(past - v), ahead(side * on), ahead(side * np.abs(v))]
        spun += [turn(past_om - om), turn(side_om * on), turn(side_om * np.abs(om))]
    yield "history of the speed", ("velocity.linear_m_s", "wheels.speeds_rpm"), driven
    yield "history of the turn", ("velocity.angular_rad_s", "wheels.speeds_rpm"), spun
    found = () if GYRO not in edges else peaks(problem, point, (GYRO,))
    waves = [wave * on for wave in _waves(m.t, found)]
    yield "time", ("t_s",), [c for wave in waves for c in (turn(wave), ahead(wave))]


def _waves(t_s: Array, found: Iterable[float]) -> list[Array]:
    """Return cosine and sine of the strongest frequencies [Hz] and of usual ones."""
    every = (*found, *FREQUENCIES_HZ)
    return [wave(2.0 * np.pi * f * t_s) for f in every for wave in (np.cos, np.sin)]


def anchor_fields(m: Motion) -> Array:
    """Return how the position moves when one of four ranging anchors measures too long.

    Shape (4, n, 2), metre per metre. Where the anchors stand is unknown: they are assumed around
    the area where the robot drove, counter-clockwise from low x and y. The least-squares position
    from the four ranges moves by ``(H'H)^-1 H' e``, H the directions to them.
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
    power = np.sum(
        [np.abs(np.fft.rfft(course, padded)) ** 2 for course in courses], axis=0
    )
    step_hz, width = FINEST_HZ / (len(power) - 1), 6
    out = []
    for _ in range(PEAKS):
        k = int(np.argmax(power))
        out.append(max(k, 1) * step_hz)
        power[max(k - width, 0) : k + width + 1] = 0.0
    return tuple(out)


def _side(values: Array, knee: float) -> Array:
    """Return the sign of a signal, smooth at zero, where a sharp one would follow the noise."""
    return np.asarray(np.tanh(values / knee))


def _unit(values: Array) -> Array:
    low, high = np.quantile(values, [0.01, 0.99])
    return np.asarray(
        np.clip((2.0 * values - low - high) / max(high - low, 1e-9), -1.5, 1.5)
    )


def _of_the_drive(stage: DriveStage, problem: Problem, point: Point) -> Iterator[Raw]:
    """Yield the families on which a disturbance of speed and duty could depend."""
    stack = problem.stack
    _, seen, duty = stage.simulate(point.model.terms)
    rate, tick = 1.0 / stage.segments.period_s, np.rint(stack.at).astype(np.int64)
    slope = np.gradient(seen, axis=0) * rate
    angle = np.cumsum(seen, axis=0) * (RAD_S_PER_RPM / rate)
    t = np.concatenate([stage.segments.times(i) for i in range(len(stage.segments))])

    def of_wheel(w: int, speed: Array | None, work: Array | None) -> Array:
        """Column of one wheel: what is added to its speed and its duty."""
        column = np.zeros(len(stack))
        for name, dense in ((SPEEDS[w], speed), (DUTIES[w], work)):
            if dense is not None and name in stack.edges:
                edge = stack.edges[name]
                column[edge] = dense[tick[edge]]
        return column

    def disturbed(w: int, shape: Array, change: Array) -> list[Array]:
        """Columns of a load of one wheel that needs `shape` more duty: the speed dips."""
        return [of_wheel(w, None, shape), -of_wheel(w, change, None) * rate * 0.005]

    for source, name in enumerate(WHEELS):
        own, columns = seen[:, source], []
        loads = [
            (shape, np.gradient(shape)) for shape in (own, slope[:, source] / 100.0)
        ]
        for w in (w for w in range(4) if w != source):
            columns.append(of_wheel(w, own, duty[:, source]))
            columns += [column for load in loads for column in disturbed(w, *load)]
        signals = ("setpoint_rpm", "speed_rpm", "duty_pct")
        yield (
            f"wheel {name}",
            tuple(f"wheel.{name}.{signal}" for signal in signals),
            columns,
        )
    for w, name in enumerate(WHEELS):
        waves = [wave(k * angle[:, w]) for k in (1, 2) for wave in (np.cos, np.sin)]
        columns = [
            column for wave in waves for column in disturbed(w, wave, np.gradient(wave))
        ]
        yield f"angle {name}", (f"wheel.{name}.angle_rad",), columns
    duties = [n for n in DUTIES if n in stack.edges]
    found = peaks(problem, point, duties or [n for n in SPEEDS if n in stack.edges])
    is_duty = np.zeros(len(stack), dtype=np.bool_)
    for name in duties:
        is_duty[stack.edges[name]] = True
    waves = _waves(t[tick[is_duty]], found)
    columns = [np.zeros(len(stack)) for _ in waves]
    for column, wave in zip(columns, waves, strict=True):
        column[is_duty] = wave
    yield "time", ("t_s",), columns
    yield "speed", SPEEDS, [
        of_wheel(w, None, shape) for w, n in enumerate(seen.T)
        for shape in (n * np.abs(n) / 60.0, n**3 / 3600.0, np.abs(n))
    ]  # fmt: skip

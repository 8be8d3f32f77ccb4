"""Machines that drive squares between marks on the floor, computed without the plant.

A wheel rolls further or less far than its encoder says by a random walk whose variance grows with
the distance (Chong and Kleeman 1997), so two runs of one machine never end at the same place.
"""

from dataclasses import dataclass

import numpy as np

from hilserver.measured.data import Channel, LogSource, MeasuredLog, Span

RADIUS_M, TRACK_M = 0.042, 0.2
WHEEL_RAD_S, PERIOD_S, FINE_S = 6.0, 0.05, 0.002
PAUSE_S, TURN_S = 0.2, 2.0
BETWEEN_RUNS_S = 1000.0
PLANT = {
    "wheel_radius_m": RADIUS_M, "track_m": TRACK_M, "max_rpm": 200, "wheelbase_m": None,
    "drive": "skid", "icr_offset_m": 0.0, "rotation_gain": "geometric_diff",
}  # fmt: skip


@dataclass(frozen=True)
class Machine:
    """What a robot really is, as factors of what its configuration says."""

    left_radius: float = 1.0
    right_radius: float = 1.0
    track: float = 1.0
    slip_m: float = 0.0  # variance of a wheel's distance per metre [m²/m]

    @classmethod
    def unequal(cls, difference: float, **other: float) -> "Machine":
        """Return a machine whose left wheels are larger by a share."""
        return cls(
            left_radius=1.0 + difference / 2, right_radius=1.0 - difference / 2, **other
        )


@dataclass(frozen=True)
class Tape:
    """How somebody marks a run: with which care, and what of it."""

    sd_m: float = 0.02
    start_yaw: bool = True  # the robot was put along a line
    end_yaw: bool = False
    yaw_sd_rad: float = 0.02
    back: bool = False  # somebody steers the robot back onto its first mark
    side: bool = False  # the length of the first side of each square is measured, too


def squares(
    machine: Machine, tape: Tape, seed: int, runs: int = 30, side_m: float = 1.0
) -> tuple[MeasuredLog, str]:
    """Return a log of squares in both directions, and the text of a file of their marks."""
    rng = np.random.default_rng(seed)
    columns: list[np.ndarray] = []
    spans, lines = [], ["marks:"]
    for run in range(runs):
        begin_s = BETWEEN_RUNS_S * run
        left, right = wheels(side_m, 1.0 if run % 2 else -1.0)
        if tape.back:
            left, right = steered(machine, left, right, rng)
        t_s = begin_s + PERIOD_S * np.arange(len(left))
        columns.append(np.stack([t_s, left, right, np.full(len(t_s), run)]))
        spans.append(Span(run, None, float(t_s[0]), float(t_s[-1])))

        if tape.back:
            lines.append(
                f"  - {{t_s: {t_s[-1] - 0.01:.2f}, same_as_t_s: {begin_s}, sd_m: {tape.sd_m}}}"
            )
            continue
        place, yaw = driven(machine, t_s, left, right, rng)
        if tape.side:
            corner_s = PAUSE_S + side_m / (RADIUS_M * WHEEL_RAD_S)
            long_m = abs(place[round(corner_s / FINE_S)]) + rng.normal(0.0, tape.sd_m)
            lines.append(
                f"  - {{t_s: {begin_s + corner_s:.2f}, from_t_s: {begin_s},"
                f" forward_m: {long_m:.4f}, sd_m: {tape.sd_m}}}"
            )
        direction = rng.uniform(-np.pi, np.pi)
        ends = place[[0, -1]] * np.exp(1j * direction)
        ends += rng.normal(0.0, tape.sd_m, 2) + 1j * rng.normal(0.0, tape.sd_m, 2)
        headings = yaw[[0, -1]] + direction + rng.normal(0.0, tape.yaw_sd_rad, 2)
        headings = np.angle(np.exp(1j * headings))  # nobody counts the turns
        marked = (tape.start_yaw, tape.end_yaw)
        times = (t_s[0], t_s[-1] - 0.01)
        for when, point, heading, known in zip(
            times, ends, headings, marked, strict=True
        ):
            more = ""
            if known:
                more = f", yaw_rad: {heading:.4f}, yaw_sd_rad: {tape.yaw_sd_rad}"
            lines.append(
                f"  - {{t_s: {when:.2f}, x_m: {point.real:.4f}, y_m: {point.imag:.4f}{more},"
                f" sd_m: {tape.sd_m}}}"
            )

    t_s, left, right, run_of_row = np.concatenate(columns, axis=1)
    span = run_of_row.astype(int)
    rpm = 30.0 / np.pi
    channels = {
        f"wheel.{wheel}.speed_rpm": Channel(t_s, rpm * speeds, span)
        for wheel, speeds in (
            ("fl", left),
            ("rl", left),
            ("fr", -right),
            ("rr", -right),
        )
    }
    source = LogSource("squares.csv", "0" * 64)
    return MeasuredLog((source,), channels, tuple(spans), plant=PLANT), "\n".join(
        lines
    ) + "\n"


def table(log: MeasuredLog) -> str:
    """Return a log of squares as CSV with signal names as columns."""
    names = tuple(log.channels)
    first = log[names[0]]
    rows = zip(first.t_s, first.span, *(log[n].values for n in names), strict=True)
    lines = [f"t_s,segment,{','.join(names)}"]
    lines += [",".join(f"{value:.5f}" for value in row) for row in rows]
    return "\n".join(lines).replace(".00000,", ",") + "\n"


def wheels(side_m: float, way: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the speeds of both wheels [rad/s] of a square that a perfect robot closes."""

    def rows(left: float, right: float, seconds: float) -> np.ndarray:
        return np.tile([[left], [right]], round(seconds / PERIOD_S))

    # speeds change linearly between rows: a piece of n rows lasts as long as n periods
    ahead = rows(WHEEL_RAD_S, WHEEL_RAD_S, side_m / (RADIUS_M * WHEEL_RAD_S))
    rim_rad_s = way * 0.25 * np.pi * TRACK_M / RADIUS_M / TURN_S
    turn, pause = rows(-rim_rad_s, rim_rad_s, TURN_S), rows(0.0, 0.0, PAUSE_S)
    left, right = np.concatenate([pause, *[ahead, pause, turn, pause] * 4], axis=1)
    return left, right


def steered(
    machine: Machine, left: np.ndarray, right: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return what the encoders say while a robot really drives what a perfect one would."""
    ahead, apart = (right + left) / 2, (right - left) / 2 * machine.track
    found = []
    for factor, rim in (
        (machine.left_radius, ahead - apart),
        (machine.right_radius, ahead + apart),
    ):
        noise = np.sqrt(machine.slip_m * abs(rim) / RADIUS_M / PERIOD_S)
        found.append((rim + noise * rng.normal(size=len(rim))) / factor)
    return found[0], found[1]


def driven(
    machine: Machine,
    t_s: np.ndarray,
    left: np.ndarray,
    right: np.ndarray,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the true place (complex) and heading at fine steps, the last row's included."""
    fine = np.arange(t_s[0], t_s[-1] - 0.01 + FINE_S / 2, FINE_S)
    middle = (fine[1:] + fine[:-1]) / 2
    rolled = []
    for factor, speeds in (
        (machine.left_radius, left),
        (machine.right_radius, right),
    ):
        step_m = RADIUS_M * factor * np.interp(middle, t_s, speeds) * FINE_S
        rolled.append(
            step_m
            + np.sqrt(machine.slip_m * abs(step_m)) * rng.normal(size=len(step_m))
        )
    turned = (rolled[1] - rolled[0]) / (TRACK_M * machine.track)
    yaw = np.concatenate([[0.0], np.cumsum(turned)])
    ahead = (rolled[0] + rolled[1]) / 2 * np.exp(1j * (yaw[1:] + yaw[:-1]) / 2)
    return np.concatenate([[0.0], np.cumsum(ahead)]), yaw

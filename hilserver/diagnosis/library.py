"""The causes that a diagnosis can name, as directions in which the plant can be changed.

A candidate has one to four parameters and a fixed shape. A cause whose effect is not linear (a
delay, a limit, a region of the floor) has several candidates, one per shape or start value; the
screen takes the best of them.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

Theta = Sequence[float]
StageName = Literal["drive", "pose"]


@dataclass(frozen=True)
class Candidate:
    """One direction, or a few together, in which the plant can be changed.

    Attributes
    ----------
    cause : str
        Public name.
    label : str
        Unique name of this candidate.
    stage : str
        Which residuals judge it.
    start : tuple of float
        Values of the parameters from which a fit begins.
    null : tuple of float
        Values at which it changes nothing.
    step : tuple of float
        Physical steps of the finite differences.
    terms : callable
        From values to terms of the plant (and ``shift.*``).
    low, high : tuple of float
        What is physically possible.
    least : float
        Size (largest parameter) below which it is not worth a name.
    linear : bool
        Whether the effect is about linear, so that the screen may extrapolate.
    hidden : int
        Parameters of its shape that were searched over, beside the fitted ones.
    tried : tuple of float
        More values to begin from where much is left to explain.
    moved : callable, optional
        From a shift of its shape (an edge [m], the logarithm of a speed) to the candidate with that
        shape, for a finer search.
    """

    cause: str
    label: str
    stage: StageName
    start: tuple[float, ...]
    null: tuple[float, ...]
    step: tuple[float, ...]
    terms: Callable[[Theta], dict[str, float]]
    low: tuple[float, ...]
    high: tuple[float, ...]
    least: float
    linear: bool = True
    hidden: int = 0
    tried: tuple[float, ...] = ()
    moved: "Callable[[float], Candidate] | None" = None

    @property
    def weight(self) -> int:
        """Parameters that it costs, fitted and hidden."""
        return self.n + self.hidden

    @property
    def n(self) -> int:
        """Number of parameters."""
        return len(self.start)

    @property
    def beginning(self) -> tuple[float, ...]:
        """Where a fit begins: the start value, or just off null."""
        if not self.linear:
            return self.start
        return tuple(n + 1e-3 * s for n, s in zip(self.null, self.step, strict=True))


def _one(
    name: str,
    stage: StageName,
    step: float,
    least: float,
    low: float = -math.inf,
    high: float = math.inf,
) -> Candidate:
    return Candidate(
        cause=name.partition(".")[0],
        label=name,
        stage=stage,
        start=(0.0,),
        null=(0.0,),
        step=(step,),
        terms=lambda theta: {name: float(theta[0])},
        low=(low,),
        high=(high,),
        least=least,
    )


def _grid(
    name: str,
    stage: StageName,
    null: float,
    values: Sequence[float],
    step: float,
    least: float,
    low: float,
    high: float,
) -> list[Candidate]:
    """One candidate per start value of a parameter whose effect is not linear."""
    return [
        Candidate(
            cause=name.partition(".")[0],
            label=f"{name}@{value:g}",
            stage=stage,
            start=(value,),
            null=(null,),
            step=(step,),
            terms=lambda theta: {name: float(theta[0])},
            low=(low,),
            high=(high,),
            least=least,
            linear=False,
        )
        for value in values
    ]


def _several(
    cause: str,
    label: str,
    stage: StageName,
    names: Sequence[str],
    step: Sequence[float],
    least: float,
    fixed: Mapping[str, float] | None = None,
    low: float = -math.inf,
    high: float = math.inf,
) -> Candidate:
    held = dict(fixed or {})

    def terms(theta: Theta) -> dict[str, float]:
        return {**dict(zip(names, map(float, theta), strict=True)), **held}

    n = len(names)
    zero = (0.0,) * n
    return Candidate(
        cause, label, stage, zero, zero, tuple(step), terms, (low,) * n, (high,) * n, least
    )


def _wave(cause: str, label: str, amplitude: str, phase: str, step: float) -> Candidate:
    """Amplitude and phase, fitted as cosine and sine parts."""

    def terms(theta: Theta) -> dict[str, float]:
        size = math.hypot(theta[0], theta[1])
        return {amplitude: size, phase: math.atan2(theta[1], theta[0]) if size > 0.0 else 0.0}

    zero, far = (0.0, 0.0), (0.5, 0.5)
    low = (-0.5, -0.5)
    return Candidate(cause, label, "pose", zero, zero, (step, step), terms, low, far, 5 * step)


DELAYS_S = (0.01, 0.04, 0.15, 0.4)
LATE_S = (0.15, 0.4)
"""Far from nought a latency is no line any more."""
PERIODS_S = (0.002, 0.003, 0.005, 0.007, 0.01, 0.013)
USUAL_PERIODS_S = (0.0015, 0.0025, 0.004, 0.006, 0.008, 0.009, 0.011, 0.012, 0.0125, 0.014)
QUANTA_RPM = (0.25, 0.5, 1.0)
RATES_RPM_S = (80.0, 150.0, 400.0)
LIMITS_PCT = (85.0, 65.0, 45.0)


def drive_candidates(limit_pct: float) -> list[Candidate]:
    """Return the candidates that set-points, wheel speeds and duties judge."""
    stage: StageName = "drive"
    found = [
        _one("process_gain", stage, 0.02, 0.005, -0.6, 2.0),
        _one("time_constant", stage, 0.05, 0.02, -0.7, 3.0),
        _one("coulomb_friction", stage, 0.5, 0.2, 0.0, 60.0),
        _one("viscous_load", stage, 0.02, 0.005, 0.0, 2.0),
        _one("dead_zone", stage, 0.5, 0.25, 0.0, 40.0),
        _one("battery_sag", stage, 0.3, 0.15, 0.0, 3.0),
        _one("controller_gains.p", stage, -0.05, 0.03, -0.9, 2.0),
        _one("controller_gains.i", stage, -0.05, 0.05, -0.9, 3.0),
        _several(
            "controller_gains",
            "controller_gains",
            stage,
            ("controller_gains.p", "controller_gains.i"),
            (-0.05, -0.05),
            0.05,
            None,
            -0.9,
            3.0,
        ),
    ]
    found += [
        _several(
            "wheel_load",
            f"wheel_load@{wheel}",
            stage,
            ("wheel_load.f",),
            (1.0,),
            0.4,
            {"wheel_load.wheel": float(wheel)},
            0.0,
            60.0,
        )
        for wheel in range(4)
    ]
    found += [_stribeck(n_s) for n_s in (3.0, 6.0, 12.0)]
    limits = [limit for limit in LIMITS_PCT if limit < limit_pct]
    found += _grid("saturation_limit", stage, 100.0, limits, -2.0, 1.0, 5.0, 99.0)
    found += _grid("actuation_delay", stage, 0.0, DELAYS_S, 0.002, 0.002, 0.0, 0.9)
    found += _grid("setpoint_rate_limit", stage, 1e9, RATES_RPM_S, -10.0, 0.0, 1.0, 1e5)
    periods = _grid("control_period", stage, 0.001, PERIODS_S, 0.001, 0.0015, 0.001, 0.02)
    found += [replace(c, tried=USUAL_PERIODS_S) for c in periods]
    found += _grid("encoder_filter", stage, 0.0, (0.005, 0.02), 0.001, 0.001, 0.0, 0.2)
    found += _grid("encoder_quantization", stage, 0.0, QUANTA_RPM, 0.1, 0.2, 0.0, 20.0)
    return found


def pose_candidates(place: tuple[float, float, float, float] | None) -> list[Candidate]:
    """Return the candidates that pose and turn rate judge.

    Parameters
    ----------
    place : tuple of float or None
        Where the robot drove: x_min, x_max, y_min, y_max [m]; None without a position.
    """
    stage: StageName = "pose"
    found = [
        _one("wheel_radius", stage, 0.01, 0.002, -0.5, 1.0),
        # 10 m with it cost about half the heading of a full turn with the least rotation_gain
        _one("wheel_radius_difference", stage, 0.005, 0.0005, -0.5, 0.5),
        _one("rotation_gain", stage, 0.01, 0.003, -0.9, 3.0),
        _one("rotation_gain_speed", stage, 0.05, 0.02, -2.0, 5.0),
        _one("rotation_gain_radius", stage, 0.05, 0.02, -0.95, 5.0),
        _one("longitudinal_slip", stage, 0.03, 0.01, -0.5, 2.0),
        _one("acceleration_slip", stage, 0.02, 0.01, 0.0, 2.0),
        _one("side_slip", stage, 0.03, 0.015, -2.0, 2.0),
        _one("icr_offset", stage, 0.02, 0.006, -0.5, 0.5),
        _one("wheel_misalignment", stage, 0.01, 0.003, -0.5, 0.5),
        _one("nav_frame_yaw", stage, 0.01, 0.005, -3.2, 3.2),
        _one("nav_latency", stage, 0.02, 0.008, 0.0, 1.5),
        _one("yaw_latency", stage, 0.02, 0.01, 0.0, 1.5),
        _one("nav_scale", stage, 0.01, 0.003, -0.5, 1.0),
        _one("gyro_bias", stage, 0.002, 0.0005, -1.0, 1.0),
        _one("gyro_scale", stage, 0.01, 0.003, -0.95, 3.0),
        _one("imu_latency", stage, 0.01, 0.004, 0.0, 1.5),
        *_grid("imu_latency", stage, 0.0, LATE_S, 0.01, 0.004, 0.0, 1.5),
        *_grid("yaw_latency", stage, 0.0, LATE_S, 0.02, 0.01, 0.0, 1.5),
        *_grid("nav_latency", stage, 0.0, LATE_S, 0.02, 0.008, 0.0, 1.5),
        replace(_one("shift.nav", stage, 0.02, 0.01, -1.5, 1.5), cause="clock_offset"),
        _several(
            "floor_slope",
            "floor_slope",
            stage,
            ("floor_slope.x", "floor_slope.y"),
            (0.005, 0.005),
            0.002,
            None,
            -0.5,
            0.5,
        ),
        _several(
            "nav_lever_arm",
            "nav_lever_arm",
            stage,
            ("nav_lever_arm.x", "nav_lever_arm.y"),
            (0.02, 0.02),
            0.006,
            None,
            -2.0,
            2.0,
        ),
        _wave(
            "heading_distortion",
            "heading_distortion.1",
            "heading_distortion.a1",
            "heading_distortion.phase1",
            0.005,
        ),
        _wave(
            "heading_distortion",
            "heading_distortion.2",
            "heading_distortion.a2",
            "heading_distortion.phase2",
            0.005,
        ),
        _wave(
            "wheel_runout", "wheel_runout", "wheel_runout.amplitude", "wheel_runout.phase", 0.005
        ),
    ]
    if place is not None:
        found += _surfaces(place)
        found += [
            replace(
                _several(
                    "nav_position_bias",
                    f"nav_position_bias@{length:g}",
                    stage,
                    ("nav_position_bias.amplitude",),
                    (0.02,),
                    0.02,
                    {"nav_position_bias.wavelength": length},
                    -5.0,
                    5.0,
                ),
                hidden=1,
            )
            for length in (3.0, 5.0, 8.0, 12.0)
        ]
    return found


def _stribeck(n_s: float) -> Candidate:
    candidate = _several(
        "stribeck_friction",
        f"stribeck_friction@{n_s:.3g}",
        "drive",
        ("stribeck_friction.f_s",),
        (1.0,),
        0.5,
        {"stribeck_friction.n_s": n_s},
        0.0,
        60.0,
    )
    return replace(
        candidate, hidden=1, moved=lambda shift: _stribeck(min(max(n_s * math.exp(shift), 0.5), 40))
    )


def _surfaces(place: tuple[float, float, float, float]) -> list[Candidate]:
    """Part of the floor, cut at several places, either side of the cut."""
    x_min, x_max, y_min, y_max = place
    return [
        _surface(axis, side, low + share * (high - low))
        for axis, low, high in (("x", x_min, x_max), ("y", y_min, y_max))
        for share in (0.25, 0.375, 0.5, 0.625, 0.75)
        for side in ("min", "max")
    ]


def _surface(axis: str, side: str, edge: float) -> Candidate:
    region = {"x_min": -1e3, "x_max": 1e3, "y_min": -1e3, "y_max": 1e3, f"{axis}_{side}": edge}
    candidate = _several(
        "surface_change",
        f"surface_change@{axis}_{side}={edge:.3f}",
        "pose",
        ("surface_change.k_om", "surface_change.v"),
        (0.05, 0.05),
        0.03,
        {f"surface_change.{key}": value for key, value in region.items()},
        -0.9,
        3.0,
    )
    return replace(candidate, hidden=2, moved=lambda shift_m: _surface(axis, side, edge + shift_m))

"""What the sensors make of the true motion: age, mounting, distortion, noise."""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from hilserver_injector.recipe import Recipe
from hilserver_injector.ultra_wideband import blocks_of_residuals

Array = NDArray[np.float64]
T, X, Y, YAW, V, VY, OM, ANGLE = range(8)
CORNERS_M = np.array([(5.5, 5.5), (5.5, -5.5), (-5.5, -5.5), (-5.5, 5.5)])


def correlated(
    rng: np.random.Generator, times: Array, deviation: float, correlation_s: float
) -> Array:
    """Return a stationary Ornstein-Uhlenbeck series at these instants [s]."""
    keep = np.exp(-np.diff(times, prepend=times[0]) / correlation_s)
    fresh = rng.standard_normal(len(times)) * np.sqrt(1.0 - keep**2)
    fresh[0] = rng.standard_normal()
    state, series = 0.0, np.empty(len(times))
    for k, (k_keep, k_fresh) in enumerate(
        zip(keep.tolist(), fresh.tolist(), strict=True)
    ):
        state = k_keep * state + k_fresh
        series[k] = state
    return deviation * series


def _at(dense: Array, column: int, times: Array) -> Array:
    return np.interp(times, dense[:, T], dense[:, column])


def _value(causes: Mapping[str, Array], name: str, n: int) -> Array:
    return causes.get(name, np.zeros(n))


def as_read(recipe: Recipe, columns: Mapping[str, Array]) -> dict[str, Array]:
    """Return the readings that the sensors of a recipe give for exact ones, by channel."""
    readings = dict(columns)
    for part, sensor in recipe.sensors.items():
        for name in (name for name in columns if part in name):
            exact = readings[name]
            rounded = (
                sensor.step * np.round(exact / sensor.step) if sensor.step else exact
            )
            readings[name] = np.clip(rounded, -sensor.limit, sensor.limit)
    return readings


def yaw_rate(
    recipe: Recipe, causes: Mapping[str, Array], dense: Array, times: Array
) -> Array:
    """Return the gyro's reading [rad/s]; `causes` hold a value per instant."""
    n = len(times)
    rng = recipe.generator("gyro")
    rate = _at(dense, OM, times - _value(causes, "imu_latency", n))
    rate = rate * (1.0 + _value(causes, "gyro_scale", n)) + _value(
        causes, "gyro_bias", n
    )
    return rate + recipe.noise.gyro_rad_s * rng.standard_normal(n)


def tag(
    recipe: Recipe, causes: Mapping[str, Array], dense: Array, times: Array
) -> tuple[Array, Array, Array]:
    """Return x [m], y [m] and yaw [rad, within -pi .. pi] of the navigation tag."""
    n = len(times)
    aged = times - _value(causes, "nav_latency", n)
    x, y, yaw = _at(dense, X, aged), _at(dense, Y, aged), _at(dense, YAW, aged)
    arm_x, arm_y = (
        _value(causes, "nav_lever_arm.x", n),
        _value(causes, "nav_lever_arm.y", n),
    )
    x, y = (
        x + arm_x * np.cos(yaw) - arm_y * np.sin(yaw),
        y + arm_x * np.sin(yaw) + arm_y * np.cos(yaw),
    )
    scale = 1.0 + _value(causes, "nav_scale", n)
    bias = _value(causes, "nav_position_bias.amplitude", n)
    wave = 2.0 * math.pi / (_value(causes, "nav_position_bias.wavelength", n) + 1e-12)
    shown_x, shown_y = scale * x, scale * y
    if np.any(bias):
        shown_x, shown_y = (
            shown_x + bias * np.cos(wave * y),
            shown_y + bias * np.cos(wave * x),
        )
    pushed_x, pushed_y = _anchor_off(x, y, _value(causes, "nav_anchor_off", n))
    shown_x, shown_y = shown_x + pushed_x, shown_y + pushed_y
    noise_x, noise_y = _position_noise(recipe, times)
    thrown_x, thrown_y = _outliers(recipe, causes, times)
    shown_yaw = _heading(
        causes, _at(dense, YAW, times - _value(causes, "yaw_latency", n))
    )
    rng = recipe.generator("heading")
    shown_yaw = shown_yaw + correlated(
        rng, times, recipe.noise.yaw_rad, recipe.noise.yaw_correlation_s
    )
    shown_yaw -= 2.0 * math.pi * np.floor((shown_yaw + math.pi) / (2.0 * math.pi))
    return shown_x + noise_x + thrown_x, shown_y + noise_y + thrown_y, shown_yaw


def _heading(causes: Mapping[str, Array], yaw: Array) -> Array:
    n = len(yaw)
    once = _value(causes, "heading_distortion.a1", n)
    twice = _value(causes, "heading_distortion.a2", n)
    first, second = (
        _value(causes, "heading_distortion.phase1", n),
        _value(causes, "heading_distortion.phase2", n),
    )
    return (
        yaw
        + once * np.sin(yaw + first)
        + twice * np.sin(2.0 * yaw + second)
        + _value(causes, "nav_frame_yaw", n)
    )


def _position_noise(recipe: Recipe, times: Array) -> tuple[Array, Array]:
    noise, rng = recipe.noise, recipe.generator("position")
    if noise.measured_position:
        return blocks_of_residuals(rng, times)
    white = noise.position_white_m * rng.standard_normal((2, len(times)))
    slow = [
        correlated(rng, times, noise.position_m, noise.position_correlation_s)
        for _ in range(2)
    ]
    return white[0] + slow[0], white[1] + slow[1]


def _anchor_off(x: Array, y: Array, error_m: Array) -> tuple[Array, Array]:
    """Return how far least squares of four ranges moves when one anchor measures too long."""
    if not np.any(error_m):
        return np.zeros(len(x)), np.zeros(len(x))
    away = np.stack([x, y], axis=1)[:, None, :] - CORNERS_M
    away /= np.linalg.norm(away, axis=2, keepdims=True)
    normal = np.einsum("nki,nkj->nij", away, away)
    moved = np.linalg.solve(normal, (error_m[:, None] * away[:, 0, :])[:, :, None])[
        :, :, 0
    ]
    return moved[:, 0], moved[:, 1]


def _outliers(
    recipe: Recipe, causes: Mapping[str, Array], times: Array
) -> tuple[Array, Array]:
    """Return samples far off, one by one or in bursts (no line of sight)."""
    n, rng = len(times), recipe.generator("outliers")
    share = _value(causes, "nav_outliers.share", n)
    size = _value(causes, "nav_outliers.size", n)
    length = int(max(causes.get("nav_outliers.burst", np.ones(1))[0], 1))
    begins = rng.random(n) < share / length
    direction = rng.uniform(0.0, 2.0 * math.pi, n)
    hit = np.zeros(n, dtype=np.int64)
    for k in np.flatnonzero(begins):
        hit[k : k + length] = k + 1
    far, source = hit > 0, np.maximum(hit - 1, 0)
    return (
        far * size * np.cos(direction[source]),
        far * size * np.sin(direction[source]),
    )

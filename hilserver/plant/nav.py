"""The navigation tag: position by ultra-wideband ranging, heading by a magnetometer.

In this order: age (position and yaw apart), lever arm, scale, bias field, noise, outliers; yaw:
distortion, frame, noise. Between two samples the last one stands. Switched off (the default), the
outputs keep their value and carry BadOutOfService.
"""

import math
from typing import Any

import hilserver.plant.layout as at
from hilserver.plant.history import between, between_angles, push, weights
from hilserver.plant.kernels import part
from hilserver.plant.noise import normal, uniform
from hilserver.plant.pose import wrap

CHANNEL_OU = 8  # 3 channels: x, y, yaw
CHANNEL_WHITE = 11  # 2 channels
CHANNEL_OUTLIER = 40  # uniform channels: whether, in which direction


@part
def _correlated(p: Any, x: Any, part: int, keep: float, deviation: float) -> float:
    """Advance an Ornstein-Uhlenbeck state by one sample, stationary from the first on."""
    sample = x[at.X_NAV_SAMPLES]
    fresh = deviation * normal(p[at.P_SEED], sample, CHANNEL_OU + part)
    if sample == 0.0:
        x[at.X_NAV_OU + part] = fresh
    else:
        x[at.X_NAV_OU + part] = keep * x[at.X_NAV_OU + part] + math.sqrt(1.0 - keep * keep) * fresh
    return float(x[at.X_NAV_OU + part])


@part
def shown_position(p: Any, x: Any) -> tuple[float, float]:
    """Return x, y [m] of the tag, of the pose that lies the delay back in the ring."""
    newer, older, share = weights(int(x[at.X_NAV_HEAD]), x[at.X_NAV_COUNT], p[at.P_NAV_DELAY])
    a, b = at.X_NAV_RING + 3 * newer, at.X_NAV_RING + 3 * older
    px, py = between(x[a], x[b], share), between(x[a + 1], x[b + 1], share)
    if p[at.P_LEVER_X] != 0.0 or p[at.P_LEVER_Y] != 0.0:
        yaw = between_angles(x[a + 2], x[b + 2], share)
        px += p[at.P_LEVER_X] * math.cos(yaw) - p[at.P_LEVER_Y] * math.sin(yaw)
        py += p[at.P_LEVER_X] * math.sin(yaw) + p[at.P_LEVER_Y] * math.cos(yaw)
    shown_x, shown_y = p[at.P_NAV_SCALE] * px, p[at.P_NAV_SCALE] * py
    if p[at.P_BIAS] != 0.0:
        shown_x += p[at.P_BIAS] * math.cos(p[at.P_BIAS_WAVE] * py)
        shown_y += p[at.P_BIAS] * math.cos(p[at.P_BIAS_WAVE] * px)
    return shown_x, shown_y


@part
def shown_yaw(p: Any, x: Any) -> float:
    """Return the yaw [rad] that the tag shows, not wrapped."""
    newer, older, share = weights(int(x[at.X_NAV_HEAD]), x[at.X_NAV_COUNT], p[at.P_NAV_YAW_DELAY])
    a, b = at.X_NAV_RING + 3 * newer + 2, at.X_NAV_RING + 3 * older + 2
    yaw = between_angles(x[a], x[b], share)
    shown = yaw
    if p[at.P_DISTORTION_1] != 0.0:
        shown += p[at.P_DISTORTION_1] * math.sin(yaw + p[at.P_DISTORTION_PHASE_1])
    if p[at.P_DISTORTION_2] != 0.0:
        shown += p[at.P_DISTORTION_2] * math.sin(2.0 * yaw + p[at.P_DISTORTION_PHASE_2])
    if p[at.P_NAV_FRAME_YAW] != 0.0:
        shown += p[at.P_NAV_FRAME_YAW]
    return float(shown)


@part
def _sample(p: Any, x: Any) -> None:
    """Take one sample: what the tag shows until the next."""
    seed, sample = p[at.P_SEED], x[at.X_NAV_SAMPLES]
    px, py = shown_position(p, x)
    yaw = shown_yaw(p, x)
    if p[at.P_NAV_OU] != 0.0:
        px += _correlated(p, x, 0, p[at.P_NAV_OU_KEEP], p[at.P_NAV_OU])
        py += _correlated(p, x, 1, p[at.P_NAV_OU_KEEP], p[at.P_NAV_OU])
    if p[at.P_NAV_YAW_OU] != 0.0:
        yaw += _correlated(p, x, 2, p[at.P_NAV_YAW_OU_KEEP], p[at.P_NAV_YAW_OU])
    if p[at.P_NAV_WHITE] != 0.0:
        px += p[at.P_NAV_WHITE] * normal(seed, sample, CHANNEL_WHITE)
        py += p[at.P_NAV_WHITE] * normal(seed, sample, CHANNEL_WHITE + 1)
    if (
        p[at.P_OUTLIER_SHARE] > 0.0
        and uniform(seed, sample, CHANNEL_OUTLIER) < p[at.P_OUTLIER_SHARE]
    ):
        direction = 2.0 * math.pi * uniform(seed, sample, CHANNEL_OUTLIER + 1)
        px += p[at.P_OUTLIER_SIZE] * math.cos(direction)
        py += p[at.P_OUTLIER_SIZE] * math.sin(direction)
    x[at.X_NAV_SAMPLES] = sample + 1.0
    x[at.X_NAV_SHOWN], x[at.X_NAV_SHOWN + 1], x[at.X_NAV_SHOWN + 2] = px, py, wrap(yaw)


@part
def nav_step(p: Any, x: Any, u: Any, y: Any, q: Any) -> None:  # noqa: ARG001 (one shape)
    """Remember the pose of t_k and, when a sample is due, publish what the tag shows."""
    if p[at.P_NAV_ENABLED] == 0.0:
        for k in range(3):
            q[at.Y_NAV + k] = at.BAD_OUT_OF_SERVICE
        return
    row = push(x, at.X_NAV_RING, 3, at.X_NAV_HEAD, at.X_NAV_COUNT)
    for k in range(3):
        x[row + k] = y[at.Y_POSE + k]
    x[at.X_NAV_WAIT] -= 1.0
    if x[at.X_NAV_WAIT] <= 0.0:
        x[at.X_NAV_WAIT] = p[at.P_NAV_EVERY]
        _sample(p, x)
    for k in range(3):
        y[at.Y_NAV + k] = x[at.X_NAV_SHOWN + k]
        q[at.Y_NAV + k] = at.GOOD

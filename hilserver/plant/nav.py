"""The navigation tag: position by ultra-wideband ranging, heading by a magnetometer.

In this order: age (position and yaw apart), lever arm, scale, bias field, noise, outliers; yaw:
distortion, frame, noise. Between two samples the last one stands. Switched off (the default), the
outputs keep their value and carry BadOutOfService.
"""

import math
from typing import Any

from hilserver.plant.history import between, between_angles, push, weights
from hilserver.plant.kernels import part
from hilserver.plant.layout import (
    BAD_OUT_OF_SERVICE,
    GOOD,
    P_BIAS,
    P_BIAS_WAVE,
    P_DISTORTION_1,
    P_DISTORTION_2,
    P_DISTORTION_PHASE_1,
    P_DISTORTION_PHASE_2,
    P_LEVER_X,
    P_LEVER_Y,
    P_NAV_DELAY,
    P_NAV_ENABLED,
    P_NAV_EVERY,
    P_NAV_FRAME_YAW,
    P_NAV_OU,
    P_NAV_OU_KEEP,
    P_NAV_SCALE,
    P_NAV_WHITE,
    P_NAV_YAW_DELAY,
    P_NAV_YAW_OU,
    P_NAV_YAW_OU_KEEP,
    P_OUTLIER_SHARE,
    P_OUTLIER_SIZE,
    P_SEED,
    X_NAV_COUNT,
    X_NAV_HEAD,
    X_NAV_OU,
    X_NAV_RING,
    X_NAV_SAMPLES,
    X_NAV_SHOWN,
    X_NAV_WAIT,
    Y_NAV,
    Y_POSE,
)
from hilserver.plant.noise import normal, uniform
from hilserver.plant.pose import wrap

CHANNEL_OU = 8  # 3 channels: x, y, yaw
CHANNEL_WHITE = 11  # 2 channels
CHANNEL_OUTLIER = 40  # uniform channels: whether, in which direction


@part
def _correlated(p: Any, x: Any, part: int, keep: float, deviation: float) -> float:
    """Advance an Ornstein-Uhlenbeck state by one sample, stationary from the first on."""
    sample = x[X_NAV_SAMPLES]
    fresh = deviation * normal(p[P_SEED], sample, CHANNEL_OU + part)
    if sample == 0.0:
        x[X_NAV_OU + part] = fresh
    else:
        x[X_NAV_OU + part] = keep * x[X_NAV_OU + part] + math.sqrt(1.0 - keep * keep) * fresh
    return float(x[X_NAV_OU + part])


@part
def shown_position(p: Any, x: Any) -> tuple[float, float]:
    """Return x, y [m] of the tag, of the pose that lies the delay back in the ring."""
    newer, older, share = weights(int(x[X_NAV_HEAD]), x[X_NAV_COUNT], p[P_NAV_DELAY])
    a, b = X_NAV_RING + 3 * newer, X_NAV_RING + 3 * older
    px, py = between(x[a], x[b], share), between(x[a + 1], x[b + 1], share)
    if p[P_LEVER_X] != 0.0 or p[P_LEVER_Y] != 0.0:
        yaw = between_angles(x[a + 2], x[b + 2], share)
        px += p[P_LEVER_X] * math.cos(yaw) - p[P_LEVER_Y] * math.sin(yaw)
        py += p[P_LEVER_X] * math.sin(yaw) + p[P_LEVER_Y] * math.cos(yaw)
    shown_x, shown_y = p[P_NAV_SCALE] * px, p[P_NAV_SCALE] * py
    if p[P_BIAS] != 0.0:
        shown_x += p[P_BIAS] * math.cos(p[P_BIAS_WAVE] * py)
        shown_y += p[P_BIAS] * math.cos(p[P_BIAS_WAVE] * px)
    return shown_x, shown_y


@part
def shown_yaw(p: Any, x: Any) -> float:
    """Return the yaw [rad] that the tag shows, not wrapped."""
    newer, older, share = weights(int(x[X_NAV_HEAD]), x[X_NAV_COUNT], p[P_NAV_YAW_DELAY])
    a, b = X_NAV_RING + 3 * newer + 2, X_NAV_RING + 3 * older + 2
    yaw = between_angles(x[a], x[b], share)
    shown = yaw
    if p[P_DISTORTION_1] != 0.0:
        shown += p[P_DISTORTION_1] * math.sin(yaw + p[P_DISTORTION_PHASE_1])
    if p[P_DISTORTION_2] != 0.0:
        shown += p[P_DISTORTION_2] * math.sin(2.0 * yaw + p[P_DISTORTION_PHASE_2])
    if p[P_NAV_FRAME_YAW] != 0.0:
        shown += p[P_NAV_FRAME_YAW]
    return float(shown)


@part
def _sample(p: Any, x: Any) -> None:
    """Take one sample: what the tag shows until the next."""
    seed, sample = p[P_SEED], x[X_NAV_SAMPLES]
    px, py = shown_position(p, x)
    yaw = shown_yaw(p, x)
    if p[P_NAV_OU] != 0.0:
        px += _correlated(p, x, 0, p[P_NAV_OU_KEEP], p[P_NAV_OU])
        py += _correlated(p, x, 1, p[P_NAV_OU_KEEP], p[P_NAV_OU])
    if p[P_NAV_YAW_OU] != 0.0:
        yaw += _correlated(p, x, 2, p[P_NAV_YAW_OU_KEEP], p[P_NAV_YAW_OU])
    if p[P_NAV_WHITE] != 0.0:
        px += p[P_NAV_WHITE] * normal(seed, sample, CHANNEL_WHITE)
        py += p[P_NAV_WHITE] * normal(seed, sample, CHANNEL_WHITE + 1)
    if p[P_OUTLIER_SHARE] > 0.0 and uniform(seed, sample, CHANNEL_OUTLIER) < p[P_OUTLIER_SHARE]:
        direction = 2.0 * math.pi * uniform(seed, sample, CHANNEL_OUTLIER + 1)
        px += p[P_OUTLIER_SIZE] * math.cos(direction)
        py += p[P_OUTLIER_SIZE] * math.sin(direction)
    x[X_NAV_SAMPLES] = sample + 1.0
    x[X_NAV_SHOWN], x[X_NAV_SHOWN + 1], x[X_NAV_SHOWN + 2] = px, py, wrap(yaw)


@part
def nav_step(p: Any, x: Any, u: Any, y: Any, q: Any) -> None:  # noqa: ARG001 (one shape)
    """Remember the pose of t_k and, when a sample is due, publish what the tag shows."""
    if p[P_NAV_ENABLED] == 0.0:
        for k in range(3):
            q[Y_NAV + k] = BAD_OUT_OF_SERVICE
        return
    row = push(x, X_NAV_RING, 3, X_NAV_HEAD, X_NAV_COUNT)
    for k in range(3):
        x[row + k] = y[Y_POSE + k]
    x[X_NAV_WAIT] -= 1.0
    if x[X_NAV_WAIT] <= 0.0:
        x[X_NAV_WAIT] = p[P_NAV_EVERY]
        _sample(p, x)
    for k in range(3):
        y[Y_NAV + k] = x[X_NAV_SHOWN + k]
        q[Y_NAV + k] = GOOD

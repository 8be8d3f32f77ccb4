"""The navigation tag: position by ultra-wideband ranging, heading by a magnetometer.

Effects act in this order: age (separate for position and yaw), lever arm, scale, bias field, noise,
outliers; on the yaw: distortion, frame, noise. The last sample holds until the next. Switched off
(the default), the outputs keep their value and carry BadOutOfService.
"""

import math

from hilserver.compiled import inlined, part
from hilserver.plant.history import between, between_angles, push, weights
from hilserver.plant.layout import Inputs, Outputs, Parameters, State, Status
from hilserver.plant.noise import normal, uniform
from hilserver.plant.pose import wrap
from hilserver.status import BAD_OUT_OF_SERVICE, GOOD

CHANNEL_OU = 8  # 3 channels: x, y, yaw
CHANNEL_WHITE = 11  # 2 channels
CHANNEL_OUTLIER = 40  # 2 uniform channels: whether it is one, and its direction


@part
def shown_position(p: Parameters, x: State) -> tuple[float, float]:
    """Return x, y [m] that the tag shows, from the pose one delay ago."""
    newer, older, share = weights(int(x.nav_head), x.nav_count, p.nav_delay)
    a, b = x.nav_ring[newer], x.nav_ring[older]
    px, py = between(a[0], b[0], share), between(a[1], b[1], share)
    if p.lever_x != 0.0 or p.lever_y != 0.0:
        yaw = between_angles(a[2], b[2], share)
        px += p.lever_x * math.cos(yaw) - p.lever_y * math.sin(yaw)
        py += p.lever_x * math.sin(yaw) + p.lever_y * math.cos(yaw)
    shown_x, shown_y = p.nav_scale * px, p.nav_scale * py
    if p.nav_bias != 0.0:
        shown_x += p.nav_bias * math.cos(p.nav_bias_wave * py)
        shown_y += p.nav_bias * math.cos(p.nav_bias_wave * px)
    return shown_x, shown_y


@part
def shown_yaw(p: Parameters, x: State) -> float:
    """Return the yaw [rad] that the tag shows, not wrapped."""
    newer, older, share = weights(int(x.nav_head), x.nav_count, p.nav_yaw_delay)
    yaw = between_angles(x.nav_ring[newer, 2], x.nav_ring[older, 2], share)
    shown = yaw
    if p.distortion_1 != 0.0:
        shown += p.distortion_1 * math.sin(yaw + p.distortion_phase_1)
    if p.distortion_2 != 0.0:
        shown += p.distortion_2 * math.sin(2.0 * yaw + p.distortion_phase_2)
    if p.nav_frame_yaw != 0.0:
        shown += p.nav_frame_yaw
    return float(shown)


@inlined
def _sample(p: Parameters, x: State) -> None:
    """Take a sample, which the tag shows until the next."""
    seed, sample, shown = p.seed, x.nav_samples, x.nav_shown
    shown[0], shown[1] = shown_position(p, x)
    shown[2] = shown_yaw(p, x)

    # Ornstein-Uhlenbeck noise of x, y and yaw, stationary from the first sample
    for axis in range(3):
        deviation = p.nav_ou if axis < 2 else p.nav_yaw_ou
        keep = p.nav_ou_keep if axis < 2 else p.nav_yaw_ou_keep
        if deviation == 0.0:
            continue
        fresh = deviation * normal(seed, sample, CHANNEL_OU + axis)
        if sample == 0.0:
            x.nav_ou[axis] = fresh
        else:
            x.nav_ou[axis] = (
                keep * x.nav_ou[axis] + math.sqrt(1.0 - keep * keep) * fresh
            )
        shown[axis] += x.nav_ou[axis]

    if p.nav_white != 0.0:
        shown[0] += p.nav_white * normal(seed, sample, CHANNEL_WHITE)
        shown[1] += p.nav_white * normal(seed, sample, CHANNEL_WHITE + 1)
    if (
        p.outlier_share > 0.0
        and uniform(seed, sample, CHANNEL_OUTLIER) < p.outlier_share
    ):
        direction = 2.0 * math.pi * uniform(seed, sample, CHANNEL_OUTLIER + 1)
        shown[0] += p.outlier_size * math.cos(direction)
        shown[1] += p.outlier_size * math.sin(direction)

    x.nav_samples = sample + 1.0
    shown[2] = wrap(shown[2])


@part
def nav_step(p: Parameters, x: State, u: Inputs, y: Outputs, q: Status) -> None:  # noqa: ARG001 (one shape)
    """Publish what the tag shows at t_k; runs after `robot_step` of the same tick."""
    show_nav(p, x, y.pose[0], y.pose[1], y.pose[2], y, q)


@part
def show_nav(
    p: Parameters, x: State, px: float, py: float, yaw: float, y: Outputs, q: Status
) -> None:
    """Store the true pose of t_k and, when a sample is due, publish what the tag shows."""
    if p.nav_enabled == 0.0:
        for k in range(3):
            q.nav[k] = BAD_OUT_OF_SERVICE
        return
    row, x.nav_count = push(x.nav_head, x.nav_count)
    x.nav_head = row
    x.nav_ring[row, 0], x.nav_ring[row, 1], x.nav_ring[row, 2] = px, py, yaw
    x.nav_wait -= 1.0
    if x.nav_wait <= 0.0:
        x.nav_wait = p.nav_every
        _sample(p, x)
    for k in range(3):
        y.nav[k] = x.nav_shown[k]
        q.nav[k] = GOOD

"""The inertial unit: yaw rate, heading and acceleration of the centre of mass, in two dimensions.

The acceleration is the exact derivative of the velocity, without gravity. The heading is the
unit's fused one: bias and scale of the gyro do not make it drift.
"""

from typing import Any

import hilserver.plant.layout as at
from hilserver.plant.history import between, between_angles, push, weights
from hilserver.plant.kernels import part
from hilserver.plant.layout import Parameters
from hilserver.plant.noise import normal

CHANNEL_GYRO = 0
CHANNEL_ACCEL_X = 1
CHANNEL_ACCEL_Y = 2


@part
def _remember(x: Any, rate: float, yaw: float, accel_x: float, accel_y: float) -> None:
    row = push(x, at.X_IMU_RING, 4, at.X_IMU_HEAD, at.X_IMU_COUNT)
    x[row] = rate
    x[row + 1] = yaw
    x[row + 2] = accel_x
    x[row + 3] = accel_y


@part
def imu_step(p: Parameters, x: Any, u: Any, y: Any, q: Any) -> None:  # noqa: ARG001 (one shape)
    """Publish what the unit shows at t_k; runs after `robot_step` of the same tick."""
    show_imu(p, x, y[at.Y_VELOCITY + 2], y[at.Y_POSE + 2], x[at.X_ACCEL], x[at.X_ACCEL + 1], y, q)


@part
def show_imu(
    p: Parameters, x: Any, rate: float, yaw: float, accel_x: float, accel_y: float, y: Any, q: Any
) -> None:
    """Publish true yaw rate, heading and acceleration with the unit's latency, noise and errors."""
    if p.imu_enabled == 0.0:
        for i in range(4):
            q[at.Y_IMU + i] = at.BAD_OUT_OF_SERVICE
        return
    if p.imu_delay != 0.0:
        _remember(x, rate, yaw, accel_x, accel_y)
        newer, older, share = weights(int(x[at.X_IMU_HEAD]), x[at.X_IMU_COUNT], p.imu_delay)
        a, b = at.X_IMU_RING + 4 * newer, at.X_IMU_RING + 4 * older
        rate = between(x[a], x[b], share)
        yaw = between_angles(x[a + 1], x[b + 1], share)
        accel_x = between(x[a + 2], x[b + 2], share)
        accel_y = between(x[a + 3], x[b + 3], share)
    rate = p.gyro_gain * rate
    if p.gyro_bias != 0.0:
        rate += p.gyro_bias
    seed, run = p.seed, x[at.X_IMU_RUNS]
    if p.gyro_noise != 0.0:
        rate += p.gyro_noise * normal(seed, run, CHANNEL_GYRO)
    if p.accel_noise != 0.0:
        accel_x += p.accel_noise * normal(seed, run, CHANNEL_ACCEL_X)
        accel_y += p.accel_noise * normal(seed, run, CHANNEL_ACCEL_Y)
    x[at.X_IMU_RUNS] = run + 1.0
    y[at.Y_IMU] = rate
    y[at.Y_IMU + 1] = yaw
    y[at.Y_IMU + 2] = accel_x
    y[at.Y_IMU + 3] = accel_y
    for i in range(4):
        q[at.Y_IMU + i] = at.GOOD

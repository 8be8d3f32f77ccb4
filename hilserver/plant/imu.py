"""The inertial unit: yaw rate, heading and acceleration of the centre of mass, in two dimensions.

The acceleration is the exact derivative of the velocity, without gravity. The heading is the
unit's fused one: bias and scale of the gyro do not make it drift.
"""

from typing import Any

import hilserver.plant.layout as at
from hilserver.plant.history import between, between_angles, push, weights
from hilserver.plant.kernels import part
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
def imu_step(p: Any, x: Any, u: Any, y: Any, q: Any) -> None:  # noqa: ARG001 (one shape)
    """Publish what the unit shows at t_k; runs after `robot_step` of the same tick."""
    show_imu(p, x, y[at.Y_VELOCITY + 2], y[at.Y_POSE + 2], x[at.X_ACCEL], x[at.X_ACCEL + 1], y, q)


@part
def show_imu(
    p: Any, x: Any, rate: float, yaw: float, accel_x: float, accel_y: float, y: Any, q: Any
) -> None:
    """Publish true yaw rate, heading and acceleration with the unit's latency, noise and errors."""
    if p[at.P_IMU_ENABLED] == 0.0:
        for i in range(4):
            q[at.Y_IMU + i] = at.BAD_OUT_OF_SERVICE
        return
    if p[at.P_IMU_DELAY] != 0.0:
        _remember(x, rate, yaw, accel_x, accel_y)
        newer, older, share = weights(int(x[at.X_IMU_HEAD]), x[at.X_IMU_COUNT], p[at.P_IMU_DELAY])
        a, b = at.X_IMU_RING + 4 * newer, at.X_IMU_RING + 4 * older
        rate = between(x[a], x[b], share)
        yaw = between_angles(x[a + 1], x[b + 1], share)
        accel_x = between(x[a + 2], x[b + 2], share)
        accel_y = between(x[a + 3], x[b + 3], share)
    rate = p[at.P_GYRO_GAIN] * rate
    if p[at.P_GYRO_BIAS] != 0.0:
        rate += p[at.P_GYRO_BIAS]
    seed, run = p[at.P_SEED], x[at.X_IMU_RUNS]
    if p[at.P_GYRO_NOISE] != 0.0:
        rate += p[at.P_GYRO_NOISE] * normal(seed, run, CHANNEL_GYRO)
    if p[at.P_ACCEL_NOISE] != 0.0:
        accel_x += p[at.P_ACCEL_NOISE] * normal(seed, run, CHANNEL_ACCEL_X)
        accel_y += p[at.P_ACCEL_NOISE] * normal(seed, run, CHANNEL_ACCEL_Y)
    x[at.X_IMU_RUNS] = run + 1.0
    y[at.Y_IMU] = rate
    y[at.Y_IMU + 1] = yaw
    y[at.Y_IMU + 2] = accel_x
    y[at.Y_IMU + 3] = accel_y
    for i in range(4):
        q[at.Y_IMU + i] = at.GOOD

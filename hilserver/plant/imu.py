"""The inertial unit: yaw rate, heading and acceleration of the centre of mass, in two dimensions.

The acceleration is the exact derivative of the velocity, without gravity. The heading is the
unit's fused one: bias and scale of the gyro do not make it drift.
"""

from typing import Any

from hilserver.plant.history import between, between_angles, push, weights
from hilserver.plant.kernels import part
from hilserver.plant.layout import (
    BAD_OUT_OF_SERVICE,
    GOOD,
    P_ACCEL_NOISE,
    P_GYRO_BIAS,
    P_GYRO_GAIN,
    P_GYRO_NOISE,
    P_IMU_DELAY,
    P_IMU_ENABLED,
    P_SEED,
    X_ACCEL,
    X_IMU_COUNT,
    X_IMU_HEAD,
    X_IMU_RING,
    X_IMU_RUNS,
    Y_IMU,
    Y_POSE,
    Y_VELOCITY,
)
from hilserver.plant.noise import normal

CHANNEL_GYRO = 0
CHANNEL_ACCEL_X = 1
CHANNEL_ACCEL_Y = 2


@part
def _remember(x: Any, rate: float, yaw: float, accel_x: float, accel_y: float) -> None:
    row = push(x, X_IMU_RING, 4, X_IMU_HEAD, X_IMU_COUNT)
    x[row] = rate
    x[row + 1] = yaw
    x[row + 2] = accel_x
    x[row + 3] = accel_y


@part
def imu_step(p: Any, x: Any, u: Any, y: Any, q: Any) -> None:  # noqa: ARG001 (one shape)
    """Publish what the unit shows at t_k; runs after `robot_step` of the same tick."""
    show_imu(p, x, y[Y_VELOCITY + 2], y[Y_POSE + 2], x[X_ACCEL], x[X_ACCEL + 1], y, q)


@part
def show_imu(
    p: Any, x: Any, rate: float, yaw: float, accel_x: float, accel_y: float, y: Any, q: Any
) -> None:
    """Publish true yaw rate, heading and acceleration with the unit's latency, noise and errors."""
    if p[P_IMU_ENABLED] == 0.0:
        for i in range(4):
            q[Y_IMU + i] = BAD_OUT_OF_SERVICE
        return
    if p[P_IMU_DELAY] != 0.0:
        _remember(x, rate, yaw, accel_x, accel_y)
        newer, older, share = weights(int(x[X_IMU_HEAD]), x[X_IMU_COUNT], p[P_IMU_DELAY])
        a, b = X_IMU_RING + 4 * newer, X_IMU_RING + 4 * older
        rate = between(x[a], x[b], share)
        yaw = between_angles(x[a + 1], x[b + 1], share)
        accel_x = between(x[a + 2], x[b + 2], share)
        accel_y = between(x[a + 3], x[b + 3], share)
    rate = p[P_GYRO_GAIN] * rate
    if p[P_GYRO_BIAS] != 0.0:
        rate += p[P_GYRO_BIAS]
    seed, run = p[P_SEED], x[X_IMU_RUNS]
    if p[P_GYRO_NOISE] != 0.0:
        rate += p[P_GYRO_NOISE] * normal(seed, run, CHANNEL_GYRO)
    if p[P_ACCEL_NOISE] != 0.0:
        accel_x += p[P_ACCEL_NOISE] * normal(seed, run, CHANNEL_ACCEL_X)
        accel_y += p[P_ACCEL_NOISE] * normal(seed, run, CHANNEL_ACCEL_Y)
    x[X_IMU_RUNS] = run + 1.0
    y[Y_IMU] = rate
    y[Y_IMU + 1] = yaw
    y[Y_IMU + 2] = accel_x
    y[Y_IMU + 3] = accel_y
    for i in range(4):
        q[Y_IMU + i] = GOOD

"""The inertial unit: yaw rate, heading and acceleration of the centre of mass, in two dimensions.

The acceleration is the exact derivative of the velocity, without gravity. The heading is the
unit's fused one, which bias and scale of the gyro do not make drift.
"""

from hilserver.compiled import inlined, part
from hilserver.plant.history import between, between_angles, push, weights
from hilserver.plant.layout import Inputs, Outputs, Parameters, State, Status
from hilserver.plant.noise import normal
from hilserver.status import BAD_OUT_OF_SERVICE, GOOD

CHANNEL_GYRO = 0
CHANNEL_ACCEL_X = 1
CHANNEL_ACCEL_Y = 2


@inlined
def _remember(
    x: State, rate: float, yaw: float, accel_x: float, accel_y: float
) -> None:
    row, x.imu_count = push(x.imu_head, x.imu_count)
    x.imu_head = row
    x.imu_ring[row, 0] = rate
    x.imu_ring[row, 1] = yaw
    x.imu_ring[row, 2] = accel_x
    x.imu_ring[row, 3] = accel_y


@part
def imu_step(p: Parameters, x: State, u: Inputs, y: Outputs, q: Status) -> None:  # noqa: ARG001 (one shape)
    """Publish the unit's outputs at t_k; runs after `robot_step` of the same tick."""
    show_imu(p, x, y.angular, y.pose[2], x.accel_x, x.accel_y, y, q)


@part
def show_imu(
    p: Parameters,
    x: State,
    rate: float,
    yaw: float,
    accel_x: float,
    accel_y: float,
    y: Outputs,
    q: Status,
) -> None:
    """Publish true yaw rate, heading and acceleration with the unit's latency, noise and errors."""
    if p.imu_enabled == 0.0:
        q.gyro = q.heading = q.accel_x = q.accel_y = BAD_OUT_OF_SERVICE
        return
    if p.imu_delay != 0.0:
        _remember(x, rate, yaw, accel_x, accel_y)
        newer, older, share = weights(int(x.imu_head), x.imu_count, p.imu_delay)
        a, b = x.imu_ring[newer], x.imu_ring[older]
        rate = between(a[0], b[0], share)
        yaw = between_angles(a[1], b[1], share)
        accel_x = between(a[2], b[2], share)
        accel_y = between(a[3], b[3], share)
    rate = p.gyro_gain * rate
    if p.gyro_bias != 0.0:
        rate += p.gyro_bias
    seed, run = p.seed, x.imu_runs
    if p.gyro_noise != 0.0:
        rate += p.gyro_noise * normal(seed, run, CHANNEL_GYRO)
    if p.accel_noise != 0.0:
        accel_x += p.accel_noise * normal(seed, run, CHANNEL_ACCEL_X)
        accel_y += p.accel_noise * normal(seed, run, CHANNEL_ACCEL_Y)
    x.imu_runs = run + 1.0
    y.gyro, y.heading = rate, yaw
    y.accel_x, y.accel_y = accel_x, accel_y
    q.gyro = q.heading = q.accel_x = q.accel_y = GOOD

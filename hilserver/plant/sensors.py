"""The sensors' kernels: each runs in its own slice, after `robot_step`, and shows t_k."""

from hilserver.plant.battery import battery_step
from hilserver.plant.imu import imu_step
from hilserver.plant.nav import nav_step
from hilserver.plant.shield import shield_step
from hilserver.plant.tof import tof_step

__all__ = ["battery_step", "imu_step", "nav_step", "shield_step", "tof_step"]

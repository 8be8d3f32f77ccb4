"""Names of the channels that are judged, in the order of the wheels."""

from typing import Final

from hilserver.plant.layout import LEFT_WHEELS, RIGHT_WHEELS, WHEELS

SIDES: Final = (LEFT_WHEELS, RIGHT_WHEELS)
SPEEDS: Final = tuple(f"wheel.{w}.speed_rpm" for w in WHEELS)
DUTIES: Final = tuple(f"wheel.{w}.duty_pct" for w in WHEELS)
SETPOINTS: Final = tuple(f"wheel.{w}.setpoint_rpm" for w in WHEELS)
DEMANDS: Final = tuple(f"wheel.{w}.demand_rpm" for w in WHEELS)
DUTY_COMMANDS: Final = tuple(f"wheel.{w}.duty_command_pct" for w in WHEELS)
TWIST: Final = ("twist.linear_m_s", "twist.angular_rad_s")
OF_MODE: Final = (SETPOINTS, (*TWIST, "twist.lateral_m_s"), DUTY_COMMANDS)
"""The set-points in force, by the value of `MODE`."""
ODOM_LINEAR: Final = "odom.linear_m_s"
ODOM_ANGULAR: Final = "odom.angular_rad_s"
FIX_LATITUDE: Final = "fix.latitude_deg"
FIX_LONGITUDE: Final = "fix.longitude_deg"
FIX_VARIANCE: Final = "fix.variance_m2"
FIX_STATUS: Final = "fix.status"
FIX: Final = (FIX_LATITUDE, FIX_LONGITUDE, FIX_VARIANCE, FIX_STATUS)
"""What a receiver of satellites says, which a position is made of."""
MODE: Final = "control.mode"
NAV_X: Final = "nav.x_m"
NAV_Y: Final = "nav.y_m"
POSITION: Final = (NAV_X, NAV_Y)
YAW: Final = "nav.yaw_rad"
GYRO: Final = "imu.gyro_z_rad_s"
IMU_YAW: Final = "imu.yaw_rad"
VOLTAGE: Final = "battery.voltage_v"
TAG: Final = (*POSITION, YAW)

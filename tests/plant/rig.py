"""A robot with its arrays, driven tick by tick."""

import numpy as np

import hilserver.plant.layout as at
from hilserver.plant.packing import initial_state, pack
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.robot import robot_step
from hilserver.plant.sensors import battery_step, imu_step, nav_step, shield_step, tof_step

SENSOR_TICKS = 10


class Rig:
    def __init__(self, **parameters):
        self.robot = RobotParameters(**parameters)
        self.p = pack(self.robot)
        self.x = initial_state(self.robot)
        self.u = np.zeros(at.N_U)
        self.u[at.U_ENABLE] = 1.0
        self.y = np.zeros(at.N_Y)
        self.q = np.full(at.N_Y, at.BAD_WAITING_FOR_INITIAL_DATA, dtype=np.int64)
        self.ticks = 0

    def wheels(self, *rpm):
        self.u[at.U_MODE] = 0.0
        self.u[at.U_SETPOINT : at.U_SETPOINT + 4] = rpm
        return self

    def twist(self, linear_m_s, angular_rad_s):
        self.u[at.U_MODE] = 1.0
        self.u[at.U_TWIST_LINEAR] = linear_m_s
        self.u[at.U_TWIST_ANGULAR] = angular_rad_s
        return self

    def duties(self, *pct):
        self.u[at.U_MODE] = at.MODE_DUTY
        self.u[at.U_DUTY : at.U_DUTY + 4] = pct
        return self

    def step(self, ticks=1):
        for _ in range(ticks):
            robot_step(self.p, self.x, self.u, self.y, self.q)
            self.ticks += 1
        return self

    def sense(self):
        imu_step(self.p, self.x, self.u, self.y, self.q)
        battery_step(self.p, self.x, self.u, self.y, self.q)
        shield_step(self.p, self.x, self.u, self.y, self.q)
        tof_step(self.p, self.x, self.u, self.y, self.q, self.robot.hall)
        nav_step(self.p, self.x, self.u, self.y, self.q)
        return self

    def drive(self, ticks):
        """Tick with the sensors every `SENSOR_TICKS`."""
        for _ in range(ticks):
            due = self.ticks % SENSOR_TICKS == 0
            self.step()
            if due:
                self.sense()
        return self

    @property
    def pose(self):
        return self.x[at.X_POSE : at.X_POSE + 3]

    @property
    def velocity(self):
        return self.y[at.Y_VELOCITY : at.Y_VELOCITY + 3]

    def rolling(self, left_rpm, right_rpm):
        """Set the wheels into steady motion at once: nothing of the drive moves any more."""
        for i, rpm in enumerate((left_rpm, left_rpm, right_rpm, right_rpm)):
            self.x[at.X_SPEED + i] = self.x[at.X_MOTOR + i] = rpm
            self.x[at.X_INTEGRAL + i] = rpm / self.robot.process.gain
        return self.wheels(left_rpm, left_rpm, right_rpm, right_rpm)

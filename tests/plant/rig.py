"""A robot with its arrays, driven tick by tick."""

import numpy as np

from hilserver.compiled.cache import part
from hilserver.plant.battery import battery_step
from hilserver.plant.imu import imu_step
from hilserver.plant.layout import MODE_DUTY, Inputs, Outputs, Status
from hilserver.plant.nav import nav_step
from hilserver.plant.packing import initial_state, pack
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.robot import robot_step
from hilserver.plant.shield import shield_step
from hilserver.plant.tof import tof_step
from hilserver.status import BAD_WAITING_FOR_INITIAL_DATA

SENSOR_TICKS = 10
VELOCITY = slice(Outputs.where("linear").start, Outputs.where("angular").stop)


@part
def all_sensors(p, x, u, y, q, hall):
    imu_step(p, x, u, y, q)
    battery_step(p, x, u, y, q)
    shield_step(p, x, u, y, q)
    tof_step(p, x, u, y, q, hall)
    nav_step(p, x, u, y, q)


# Called once for many ticks: a call from Python costs more than a hundred ticks.
@part
def run(p, x, u, y, q, hall, first, ticks, sensor_ticks):
    for tick in range(first, first + ticks):
        robot_step(p, x, u, y, q)
        if sensor_ticks and tick % sensor_ticks == 0:
            all_sensors(p, x, u, y, q, hall)


@part
def read_again_and_again(p, x, u, y, q, hall, outputs, rows):
    for i in range(len(rows)):
        all_sensors(p, x, u, y, q, hall)
        for k in range(len(outputs)):
            rows[i, k] = outputs[k]


class Rig:
    def __init__(self, **parameters):
        self.robot = RobotParameters(**parameters)
        self.p = pack(self.robot)
        self.x = initial_state(self.robot)
        self.u = Inputs.zeros()
        self.u.enable = 1.0
        self.y = Outputs.zeros()
        self.q = Status.of(np.full(Status.n_words, BAD_WAITING_FOR_INITIAL_DATA))
        self.ticks = 0

    def wheels(self, *rpm):
        self.u.mode = 0.0
        self.u.setpoint = rpm
        return self

    def twist(self, linear_m_s, angular_rad_s):
        self.u.mode = 1.0
        self.u.twist_linear = linear_m_s
        self.u.twist_angular = angular_rad_s
        return self

    def duties(self, *pct):
        self.u.mode = MODE_DUTY
        self.u.duty = pct
        return self

    def step(self, ticks=1):
        return self._run(ticks, 0)

    def drive(self, ticks):
        """Tick with the sensors every `SENSOR_TICKS`."""
        return self._run(ticks, SENSOR_TICKS)

    def _run(self, ticks, sensor_ticks):
        words = self.p, self.x, self.u, self.y, self.q
        run(*words, self.robot.hall, self.ticks, ticks, sensor_ticks)
        self.ticks += ticks
        return self

    def sense(self):
        all_sensors(self.p, self.x, self.u, self.y, self.q, self.robot.hall)
        return self

    def sensed(self, times):
        """Read the sensors again and again; return all outputs of each reading."""
        rows = np.empty((times, len(self.y.numbers)))
        words = self.p, self.x, self.u, self.y, self.q
        read_again_and_again(*words, self.robot.hall, self.y.numbers, rows)
        return rows

    @property
    def pose(self):
        return self.x.pose

    @property
    def velocity(self):
        return self.y.numbers[VELOCITY]

    def rolling(self, left_rpm, right_rpm):
        """Set the wheels into steady motion at once: nothing of the drive moves any more."""
        for i, rpm in enumerate((left_rpm, left_rpm, right_rpm, right_rpm)):
            self.x.speed[i] = self.x.motor[i] = rpm
            self.x.integral[i] = rpm / self.robot.process.gain
        return self.wheels(left_rpm, left_rpm, right_rpm, right_rpm)

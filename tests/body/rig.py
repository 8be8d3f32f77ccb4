"""A body with its arrays, stepped slice by slice outside the daemon."""

import math

import numpy as np

import hilserver.body.layout as at
from hilserver.body.engine import Engine
from hilserver.body.parameters import BodyParameters, Tyre
from hilserver.body.step import advance
from hilserver.plant.parameters import RobotParameters

MIRROR = np.array([1.0, 1.0, -1.0, -1.0])
MECANUM = {
    "drive": "mecanum",
    "wheel_radius_m": 0.05,
    "wheelbase_m": 0.25,
    "track_m": 0.36,
    "icr_offset_m": 0.0,
}


class Body:
    def __init__(self, *, robot=None, solids=(), tyre=None, **changes):
        self.robot = RobotParameters(solids=tuple(solids), **(robot or {}))
        self.parameters = BodyParameters(robot=self.robot, tyre=Tyre(**(tyre or {})), **changes)
        self.engine = Engine(self.parameters)
        self.b = self.engine.initial.copy()

    def run(self, seconds, *asked):
        """Run with `asked` of each wheel: rad/s or %, forward positive."""
        self.b[at.B_ASKED : at.B_ASKED + 4] = asked
        for _ in range(round(seconds / self.parameters.slice_s)):
            assert advance(self.engine.parameters, self.b, self.engine.addresses)
        return self

    def measured(self, seconds, *asked):
        """Like `run`; return the means of forward, lateral and turning velocity."""
        seen = []
        for _ in range(round(seconds / self.parameters.slice_s)):
            self.run(self.parameters.slice_s, *asked)
            seen.append(self.velocity)
        return np.mean(seen, axis=0)

    @property
    def place(self):
        return self.b[at.B_QPOS : at.B_QPOS + 3].copy()

    @property
    def yaw(self):
        w, x, y, z = self.b[at.B_QPOS + 3 : at.B_QPOS + 7]
        return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))

    @property
    def velocity(self):
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        vx, vy = self.b[at.B_QVEL : at.B_QVEL + 2]
        return cos * vx + sin * vy, cos * vy - sin * vx, self.b[at.B_QVEL + 5]

    @property
    def energy_j(self):
        """Kinetic energy of body and wheels, and potential energy."""
        p = self.parameters
        moments, turning = np.array(p.moments_kg_m2), self.b[at.B_QVEL + 3 : at.B_QVEL + 6]
        speed = self.b[at.B_QVEL : at.B_QVEL + 3]
        wheels = self.b[at.B_SPEED : at.B_SPEED + 4]
        kinetic = p.mass_kg * speed @ speed + moments @ turning**2
        kinetic += p.wheel_inertia_kg_m2 * wheels @ wheels
        return 0.5 * kinetic + p.mass_kg * 9.81 * self.b[at.B_QPOS + 2]

    def __getitem__(self, first):
        return self.b[first : first + 4]

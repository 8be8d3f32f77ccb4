"""A body with its arrays, stepped slice by slice outside the daemon."""

import math

import numpy as np

from hilserver.body.engine import BodyEngine
from hilserver.body.layout import BodyMotion
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
        self.parameters = BodyParameters(
            robot=self.robot, tyre=Tyre(**(tyre or {})), **changes
        )
        self.engine = BodyEngine(self.parameters)
        self.numbers = self.engine.initial.copy()
        self.b = BodyMotion.of(self.numbers)

    def run(self, seconds, *asked):
        """Run with `asked` of each wheel: rad/s or %, forward positive."""
        self.b.asked = asked
        for _ in range(round(seconds / self.parameters.slice_s)):
            assert advance(self.engine.parameters, self.numbers, self.engine.addresses)
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
        return self.b.position.copy()

    @property
    def yaw(self):
        w, x, y, z = self.b.orientation
        return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))

    @property
    def velocity(self):
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        vx, vy, _ = self.b.velocity
        return cos * vx + sin * vy, cos * vy - sin * vx, self.b.turning[2]

    @property
    def energy_j(self):
        """Kinetic energy of body and wheels, and potential energy."""
        p = self.parameters
        moments, turning = np.array(p.moments_kg_m2), self.b.turning
        speed = self.b.velocity
        wheels = self.b.speed
        kinetic = p.mass_kg * speed @ speed + moments @ turning**2
        kinetic += p.wheel_inertia_kg_m2 * wheels @ wheels
        return 0.5 * kinetic + p.mass_kg * 9.81 * self.b.position[2]

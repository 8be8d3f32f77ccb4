"""MuJoCo's model as text (MJCF): floor, hall, and the robot as one body on four wheels."""

import math
from collections.abc import Iterable

from hilserver.body.parameters import (
    BUMPER_GAP_M,
    GRAVITY_M_S2,
    PLATES_M,
    WHEEL_WIDTH_M,
    BodyParameters,
)
from hilserver.plant.hall import Solid
from hilserver.plant.layout import WHEELS

_BODY = 'name="robot"'
SOFT = 'solref="0.02 1" solimp="0.9 0.95 0.001"'


def mjcf(body: BodyParameters, solids: Iterable[Solid] = ()) -> str:
    """Return the model that the kernel steps: contacts without friction, the tyres are ours.

    Wheels are capsules: their contact with an edge is exact. They touch only what carries them
    (contype 1), the bumper in front of them touches everything (contype 1 and 2).
    """
    ahead, aside, height = body.centre_of_mass_m
    bottom, top = body.robot.wheel_radius_m / 2, max(2 * body.robot.wheel_radius_m, 0.15)
    length = max(PLATES_M[0], (body.robot.wheelbase_m or 0.0) + 2 * body.robot.wheel_radius_m)
    width = max(PLATES_M[1], body.robot.track_m + WHEEL_WIDTH_M)
    bumper = (length / 2 + BUMPER_GAP_M, width / 2 + BUMPER_GAP_M, (top - bottom) / 2)
    middle = (-ahead, -aside, (top + bottom) / 2 - height)
    moments = " ".join(f"{moment:.17g}" for moment in body.moments_kg_m2)
    wheels = "\n".join(_wheel(name, body, i) for i, name in enumerate(WHEELS))
    contacts = "\n".join(
        f'    <contact geom1="wheel_{name}" num="1" data="force pos" reduce="netforce"/>'
        for name in WHEELS
    )
    return f"""<mujoco model="hilserver">
  <option timestep="{body.step_s:.17g}" gravity="0 0 -{GRAVITY_M_S2}" integrator="Euler">
    <flag autoreset="disable"/>
  </option>
  <size memory="4M"/>
  <default>
    <geom condim="1" contype="0" conaffinity="0" {SOFT}/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="50 50 1" contype="1"/>
{_hall(solids)}
    <body {_BODY} pos="0 0 {height:.17g}">
      <freejoint/>
      <inertial pos="0 0 0" mass="{body.mass_kg:.17g}" diaginertia="{moments}"/>
      <site name="imu"/>
      <geom name="bumper" type="box" conaffinity="3" size="{_text(bumper)}" pos="{_text(middle)}"/>
{wheels}
    </body>
  </worldbody>
  <sensor>
{contacts}
    <accelerometer site="imu"/>
  </sensor>
</mujoco>
"""


def _wheel(name: str, body: BodyParameters, i: int) -> str:
    place = " ".join(f"{c:.17g}" for c in body.wheels_m[i])
    radius, half = body.robot.wheel_radius_m, WHEEL_WIDTH_M / 2
    return (
        f'      <geom name="wheel_{name}" type="capsule" conaffinity="1" pos="{place}"'
        f' size="{radius:.17g} {half:.6g}" zaxis="0 1 0"/>'
    )


def _hall(solids: Iterable[Solid]) -> str:
    return "\n".join(
        f'    <geom name="hall_{i}" type="box" contype="{1 if s.carries else 2}"'
        f' size="{_text(s.half_m)}" pos="{_text(s.centre_m)}" xyaxes="{_axes(s)}"/>'
        for i, s in enumerate(solids)
    )


def _text(numbers: Iterable[float]) -> str:
    return " ".join(f"{number:.9g}" for number in numbers)


def _axes(solid: Solid) -> str:
    c, s, tilt = math.cos(solid.yaw_rad), math.sin(solid.yaw_rad), solid.pitch_rad
    along = (c * math.cos(tilt), s * math.cos(tilt), math.sin(tilt))
    return _text((*along, -s, c, 0.0))

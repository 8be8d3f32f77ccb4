"""The hall and the robot as a 3D scene."""

import math
from typing import Any, Final

from foxglove import messages as fg
from numpy.typing import NDArray

from hilserver.body.parameters import WHEEL_WIDTH_M
from hilserver.ros.robot import Shape

WALL_HEIGHT_M: Final = 0.3
_GREY = fg.Color(r=0.6, g=0.6, b=0.65, a=0.8)
_BODY = fg.Color(r=0.1, g=0.4, b=0.8, a=0.9)
_DARK = fg.Color(r=0.1, g=0.1, b=0.1, a=1.0)


def scene(hall: NDArray[Any], shape: Shape) -> Any:
    """Return walls in frame ``map`` and the robot in ``base_link``.

    `hall`, shape (4 n,): ends x1, y1, x2, y2 of each wall [m].
    """
    walls = [_wall(*wall) for wall in hall.reshape(-1, 4).tolist()]
    length = shape.wheelbase_m + shape.wheel_radius_m
    width = shape.track_m - WHEEL_WIDTH_M
    chassis = fg.CubePrimitive(
        pose=_pose(), size=fg.Vector3(x=length, y=max(width, 0.02), z=0.08), color=_BODY
    )
    radius = 2.0 * shape.wheel_radius_m
    size = fg.Vector3(x=radius, y=radius, z=WHEEL_WIDTH_M)
    lying = fg.Quaternion(x=math.sqrt(0.5), y=0.0, z=0.0, w=math.sqrt(0.5))
    wheels = [
        fg.CylinderPrimitive(
            pose=_pose(0.5 * x * shape.wheelbase_m, 0.5 * y * shape.track_m, lying),
            size=size,
            bottom_scale=1.0,
            top_scale=1.0,
            color=_DARK,
        )
        for x in (1, -1)
        for y in (1, -1)
    ]
    hall_entity = fg.SceneEntity(id="hall", frame_id="map", cubes=walls)
    robot_entity = fg.SceneEntity(
        id="robot",
        frame_id="base_link",
        frame_locked=True,
        cubes=[chassis],
        cylinders=wheels,
    )
    return fg.SceneUpdate(entities=[hall_entity, robot_entity])


def _wall(x1: float, y1: float, x2: float, y2: float) -> Any:
    half = 0.5 * math.atan2(y2 - y1, x2 - x1)
    turned = fg.Quaternion(x=0.0, y=0.0, z=math.sin(half), w=math.cos(half))
    length_m = math.hypot(x2 - x1, y2 - y1)
    x = 0.5 * (x1 + x2)
    y = 0.5 * (y1 + y2)
    middle = _pose(x, y, turned, 0.5 * WALL_HEIGHT_M)
    size = fg.Vector3(x=length_m, y=0.02, z=WALL_HEIGHT_M)
    return fg.CubePrimitive(pose=middle, size=size, color=_GREY)


def _pose(x: float = 0.0, y: float = 0.0, turned: Any = None, z: float = 0.0) -> Any:
    upright = fg.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
    position = fg.Vector3(x=x, y=y, z=z)
    return fg.Pose(position=position, orientation=turned or upright)

"""The ROS 2 node of a daemon, and the robot's dimensions as messages need them."""

from typing import TYPE_CHECKING

from hilserver.body.export import robot_urdf
from hilserver.core.clock import UtcClock
from hilserver.daemon.assembly import Assembly
from hilserver.daemon.builder import Core
from hilserver.daemon.supervision import Supervision
from hilserver.ros.robot import Shape

if TYPE_CHECKING:
    from hilserver.io.ros2.node import Ros2Node


def make_ros2(core: Core, clock: UtcClock, supervision: Supervision) -> "Ros2Node | None":
    """Return the ROS 2 node, None where the configuration has none."""
    config = core.assembly.config.ros2
    if not config.enabled:
        return None
    from hilserver.io.ros2.node import NAME, Ros2Node, World  # noqa: PLC0415 -- an extra

    world = World(
        table=core.table,
        shape=shape_of(core.assembly),
        gate=core.gate,
        events=core.events,
        clock=clock,
        description=lambda prefix: robot_urdf(core.assembly.body, prefix),
        latest=core.image.latest,
        on_stale=lambda: supervision.on_stale(NAME),
        period_ns=core.assembly.base_period_ns,
    )
    return Ros2Node(config, world, core.lines[NAME])


def shape_of(assembly: Assembly) -> Shape:
    """Return the robot's dimensions."""
    robot, packed = assembly.robot, assembly.composition.parameters
    x_m, y_m = robot.tof.mount_x_m, robot.tof.mount_y_m
    return Shape(
        rpm_per_m_s=packed.rpm_per_m_s,
        rpm_per_rad_s=packed.rpm_per_rad_s,
        max_rpm=robot.max_rpm,
        max_linear_m_s=robot.ranges.max_linear_m_s,
        max_lateral_m_s=robot.ranges.max_lateral_m_s,
        max_angular_rad_s=robot.ranges.max_angular_rad_s,
        wheel_radius_m=robot.wheel_radius_m,
        wheelbase_m=robot.wheelbase_m or 0.0,
        track_m=robot.track_m,
        tof_field_rad=robot.tof.field_of_view_rad,
        tof_x_m=(x_m, x_m, -x_m, -x_m),
        tof_y_m=(y_m, -y_m, y_m, -y_m),
    )

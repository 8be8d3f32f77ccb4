"""ROS 2 over DDS, without a ROS installation: the only room that imports `cyclonedds`.

`wire` describes the types to DDS, `participant` opens the domain, `node` is the robot's program:
it publishes, subscribes to and serves what a flavour of `hilserver.ros.flavours` lists.
"""

from collections.abc import Iterator

from hilserver.io.world import Part, World


def parts(world: World) -> Iterator[Part]:
    """Yield the node, if the configuration has one, and the real robot that it hears."""
    if world.config.ros2.enabled:
        from hilserver.io.ros2.node import NAME, Ros2Node  # noqa: PLC0415 -- an extra

        node = Ros2Node(world.config.ros2, world, world.lines[NAME])
        yield node
        if node.real is not None:
            yield node.real

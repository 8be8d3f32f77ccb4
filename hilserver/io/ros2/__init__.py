"""ROS 2 over DDS, without a ROS installation: the only room that imports `cyclonedds`.

`wire` tells DDS the types, `participant` opens the domain, `node` is the robot's program: it
publishes, listens and serves what a flavour of `hilserver.ros.flavours` lists.
"""

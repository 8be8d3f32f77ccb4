"""What ROS 2 says about the robot: types, topics and messages, without any transport.

`types` knows every message and service, `flavours` the topics of three robot programs, `outgoing`
makes messages of signals, `incoming` makes signals of messages. DDS (`hilserver.io.ros2`) and bags
(`hilserver.logs`) both use them.
"""

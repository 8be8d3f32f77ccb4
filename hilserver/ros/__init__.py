"""The robot in ROS 2: types, topics and messages, without any transport.

`types` has every message and service, `flavours` the topics of three robot programs; `outgoing`
makes messages from signals, `incoming` signals from messages. DDS (`hilserver.io.ros2`) and bags
(`hilserver.logs`) both use them.
"""

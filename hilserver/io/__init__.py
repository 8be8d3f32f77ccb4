"""Links to the outside: OPC UA, S7, ROS 2, shield, databus, page, viewers, recorder."""

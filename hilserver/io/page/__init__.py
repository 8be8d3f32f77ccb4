"""The operator page: a process of its own that shows the robot and acts as its users may.

It reads the process image in shared memory and does everything else through the daemon's OPC UA
server, so that it can neither disturb a deadline nor do what its user may not.
"""

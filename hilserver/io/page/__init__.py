"""The operator page: a separate process that shows the robot and acts for its users.

It reads the process image in shared memory and does everything else through the daemon's OPC UA
server, so that it can neither disturb a deadline nor exceed the rights of its user.
"""

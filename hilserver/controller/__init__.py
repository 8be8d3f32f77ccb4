"""The embedded controller of ``make run``: an OPC UA server in its own process, as on an IOT2050.

It offers set-points with a sequence counter and time stamps, reads the pose back from nodes that
the daemon writes, and drives a figure of eight in closed loop. ``path`` is the control law,
``server`` the address space, ``loop`` the cycle.
"""

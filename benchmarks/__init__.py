"""Benches that compare hilserver with its peers and rivals, and the campaign of its diagnosis.

They run from a checkout and are not part of the installed package: ``python -m benchmarks NAME``.
"""

BENCHES = {
    "jitter": "wake latency under OPC UA load, page, body, ROS 2, observer, against cyclictest",
    "start": "to the first tick and in memory, against the import of the libraries",
    "opcua": "what being watched costs: CPU per delivered value, next to stock asyncua",
    "attack": "malformed packets and floods against the OPC UA server, next to a healthy client",
    "stop": "how late dead-man and Stop are, idle and under each attack, worst of 200",
    "page": "what the operator page costs: server, plant's deadlines, browser",
    "shield": "serial line of the shield: rate, lateness next to cyclictest, cost",
    "s7": "a controller closes a loop of 100 Hz over S7: age, round trip, next to python-snap7",
    "ros2": "ROS 2 over DDS: rate, latency, losses, cost, next to two other DDS programs",
    "mechatronic": "a step of the body beside plain mj_step; the plant's wake latency with it",
    "recalibration": "a robot changes and its model follows: right, wrong, false, taken back",
    "observer": "where the robot is: consistency, error beside other filters, cost of a step",
    "a53": "instructions of a tick on aarch64 (IOT2050) beside x86-64, counted in qemu",
    "fmu": "a step of the robot's FMU beside the daemon's; FMUs of others beside the paced plant",
    "tune": "wake latency while parameters change 20 times a second, against none",
    "sweep": "machines a minute, what Dask adds, memory; sweeps whose truth is known",
    "diagnose": "hidden causes in hundreds of logs: found, missed, misnamed",
}
"""Name of a module with ``add_arguments`` and ``run`` -> what it measures."""

"""Drive the simulated IOT Bot over ROS 2 from a program without ROS, and without any IDL by hand.

The types are those that the daemon speaks itself. Start it with `hilserver run -c config.yaml`,
then this; both take the domain from ROS_DOMAIN_ID.
"""

import time

from hilserver.config.ros2 import Ros2Config
from hilserver.io.ros2.participant import Participant
from hilserver.io.ros2.wire import WireTypes
from hilserver.ros.qos import Qos
from hilserver.ros.types import Types

SPEED = "iotbot_interface/msg/RotationSpeed"
ENABLE = "iotbot_interface/srv/SendEnable"
FORWARD_RPM = 30.0
DRIVE_S, PATIENCE_S, PERIOD_S = 3.0, 30.0, 0.02

types = Types()
wire = WireTypes(types)
participant = Participant(Ros2Config(enabled=True))


def writer(topic: str, kind: str, hashed: str):
    """Return a function that writes one message of a topic."""
    out = participant.writer(topic, wire.make(kind), Qos(), types.hash(hashed))
    return out, lambda **fields: out.write(types.encode(types.make(kind, **fields)))


def main() -> None:
    """Enable the drive, drive forward and stop."""
    targets, drive = writer("rt/iotbot/rpm", SPEED, SPEED)
    calls, enable = writer(
        "rq/iotbot/srv/send_enableRequest", f"{ENABLE}_Request", ENABLE
    )
    type_hash = types.hash(SPEED)
    returned = participant.reader(
        "rt/iotbot/rpm/return", wire.make(SPEED), Qos(), type_hash
    )
    last_s = time.monotonic() + PATIENCE_S
    while not (targets.matched and calls.matched and returned.matched):
        if time.monotonic() > last_s:
            raise SystemExit("nobody answers: does hilserver run in this domain?")
        time.sleep(0.1)
    enable(enable=True)  # once, and again whenever the robot was stopped by silence
    begin_s, fastest_rpm = time.monotonic(), 0.0
    while time.monotonic() - begin_s < DRIVE_S:
        # Right wheels are mirrored: forward is negative there.
        drive(
            front_left_rpm=FORWARD_RPM,
            rear_left_rpm=FORWARD_RPM,
            front_right_rpm=-FORWARD_RPM,
            rear_right_rpm=-FORWARD_RPM,
        )
        for arrival in returned.take():
            measured = types.decode(arrival.cdr, SPEED).front_left_rpm
            fastest_rpm = max(fastest_rpm, measured)
        time.sleep(PERIOD_S)
    drive(
        front_left_rpm=0.0, rear_left_rpm=0.0, front_right_rpm=0.0, rear_right_rpm=0.0
    )
    print(f"the front left wheel turned with {fastest_rpm:.1f} rpm")


if __name__ == "__main__":
    main()

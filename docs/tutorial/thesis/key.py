"""The key of section 6.1, without ROS: one message on /rpm, and nothing in between.

The domain is that of ROS_DOMAIN_ID, as in the daemon.
"""

import time

import numpy as np

from hilserver.config.ros2 import Ros2Config
from hilserver.io.ros2.participant import Participant
from hilserver.io.ros2.wire import WireTypes
from hilserver.ros.qos import Qos
from hilserver.ros.types import Types

ARRAY = "std_msgs/msg/Float32MultiArray"
PATIENCE_S = 60.0

types = Types()
kind, type_hash = WireTypes(types).make(ARRAY), types.hash(ARRAY)
participant = Participant(Ros2Config(enabled=True))
targets = participant.writer("rt/rpm", kind, Qos(), type_hash)
returned = participant.reader("rt/rpm/return", kind, Qos(), type_hash)


def press(rpm: float) -> None:
    """Publish the wheel speeds fl, rl, fr, rr once, as the node does for a key."""
    wheels = np.array([rpm, rpm, -rpm, -rpm], dtype=np.float32)
    layout = types.make("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
    targets.write(types.encode(types.make(ARRAY, layout=layout, data=wheels)))


def speed() -> float:
    """Return the newest speed of the front left wheel."""
    last_s = time.monotonic() + PATIENCE_S
    while not (arrivals := returned.take()):
        if time.monotonic() > last_s:
            raise SystemExit("nobody answers: does hilserver run in this domain?")
        time.sleep(0.05)
    return float(types.decode(arrivals[-1].cdr, ARRAY).data[0])


while not targets.matched:
    speed()  # says after a while that nobody answers
press(30.0)
for _ in range(3):
    time.sleep(1.0)
    print(f"no key for a while: the wheel turns with {speed():.1f} rpm")
press(0.0)
time.sleep(1.0)
print(f"S: {speed():.1f} rpm")

"""A node whose type has the right name and other fields, which no real ROS 2 makes by itself.

Arguments: domain, topic, ``described`` (it announces its fields to DDS as well, as Cyclone DDS
does) or ``undescribed`` (only their hash, all that is heard of Fast DDS). It writes until its
standard input ends.
"""

import asyncio
import sys

import numpy as np

from hilserver.config.ros2 import Ros2Config
from hilserver.io.ros2.participant import Participant
from hilserver.io.ros2.wire import WireTypes
from hilserver.ros.qos import Qos
from hilserver.ros.types import Types

FLOATS = "std_msgs/msg/Float32MultiArray"
FIELDS = "float32[] data\nuint32 data_offset\n"


async def main(domain, topic, how):
    types = Types()
    known = WireTypes(Types()).make(FLOATS)
    del types.store.fielddefs[FLOATS]
    types.add(FLOATS, FIELDS)
    participant = Participant(Ros2Config(enabled=True, domain=domain))
    made = WireTypes(types).make(FLOATS) if how == "described" else known
    writer = participant.writer(f"rt{topic}", made, Qos(), types.hash(FLOATS))
    numbers = np.array([0.0, 4.0, 9.0, 9.0, 9.0, 9.0], dtype=np.float32)
    cdr = types.encode(types.make(FLOATS, data=numbers, data_offset=0))
    ended = asyncio.create_task(asyncio.to_thread(sys.stdin.read))
    while not ended.done():
        writer.write(cdr)
        await asyncio.sleep(0.02)
    await participant.close()


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), *sys.argv[2:]))

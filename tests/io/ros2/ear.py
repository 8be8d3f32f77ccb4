"""Our side of DDS without a daemon: joins a domain, hears /cmd_vel, writes /echo for each.

Arguments: domain, interface. It ends with its standard input.
"""

import asyncio
import sys

from hilserver.config.ros2 import Ros2Config
from hilserver.io.ros2.participant import Participant
from hilserver.io.ros2.wire import WireTypes
from hilserver.ros.qos import Qos
from hilserver.ros.types import Types

TWIST = "geometry_msgs/msg/Twist"


async def main(domain, interface):
    config = Ros2Config(
        enabled=True, domain=domain, interface=interface, allow_insecure_network=True
    )
    types, participant = Types(), Participant(config)
    made = WireTypes(types).make(TWIST)
    reader = participant.reader(
        "rt/cmd_vel", made, Qos(reliable=False), types.hash(TWIST)
    )
    writer = participant.writer("rt/echo", made, Qos(), types.hash(TWIST))

    def on_data():
        for arrival in reader.take():
            writer.write(arrival.cdr)

    participant.listen(on_data)
    print("joined", flush=True)
    await asyncio.to_thread(sys.stdin.read)
    await participant.close()


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), sys.argv[2]))

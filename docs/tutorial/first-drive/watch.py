"""Print the robot's pose ten times: watch.py [endpoint]."""

import asyncio
import sys

from asyncua import Client

ENDPOINT = "opc.tcp://127.0.0.1:4840/hilserver"


async def main(endpoint: str) -> None:
    async with Client(endpoint) as client:
        space = await client.get_namespace_index("urn:hilserver:robot")
        pose = [
            client.get_node(f"ns={space};s=pose.{name}")
            for name in ("x_m", "y_m", "yaw_rad")
        ]
        for _ in range(10):
            x, y, yaw = await client.read_values(pose)
            print(f"x {x:+.3f} m   y {y:+.3f} m   yaw {yaw:+.3f} rad", flush=True)
            await asyncio.sleep(0.5)


endpoint = sys.argv[1] if len(sys.argv) > 1 else ENDPOINT
try:
    asyncio.run(main(endpoint))
except OSError:
    sys.exit(
        f"{endpoint} does not answer: wait until 'make run' has printed its addresses"
    )

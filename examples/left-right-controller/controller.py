"""A controller with one value per side, as an OPC UA server: the robot weaves along a line."""

import asyncio
import math
import sys

from asyncua import Server, ua

ENDPOINT = "opc.tcp://127.0.0.1:53880/controller"
NAMESPACE = "urn:example:left-right"
CYCLE_S = 0.02


async def main(endpoint: str) -> None:
    """Offer new speeds every cycle until Ctrl-C."""
    server = Server()
    await server.init()
    server.set_endpoint(endpoint)
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    space = await server.register_namespace(NAMESPACE)
    folder = await server.nodes.objects.add_folder(space, "drive")
    left = await folder.add_variable(ua.NodeId("left_rpm", space), "left_rpm", 0.0)
    right = await folder.add_variable(ua.NodeId("right_rpm", space), "right_rpm", 0.0)
    counter = ua.Variant(0, ua.VariantType.UInt32)
    cycle = await folder.add_variable(ua.NodeId("cycle", space), "cycle", counter)
    async with server:
        print(f"listening on {endpoint}", flush=True)
        number = 0
        while True:
            weave = 10.0 * math.sin(number * CYCLE_S)
            await left.write_value(30.0 + weave)
            # right wheels are mirrored: forward is negative
            await right.write_value(-30.0 + weave)
            number += 1
            # last: all is new
            await cycle.write_value(ua.Variant(number, ua.VariantType.UInt32))
            await asyncio.sleep(CYCLE_S)


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1] if len(sys.argv) > 1 else ENDPOINT))

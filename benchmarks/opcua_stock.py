"""asyncua's own server with Doubles that change at a fixed rate: the reference of `bench opcua`.

``python -m benchmarks.opcua_stock PORT NODES RATE_HZ`` prints a line once it listens, and serves
until its standard input ends.
"""

import asyncio
import logging
import sys
import time
from datetime import UTC, datetime

from asyncua import Server, ua

_GOOD = ua.StatusCode(ua.StatusCodes.Good)


async def main(port: int, n_nodes: int, rate_hz: float) -> None:
    """Serve until standard input ends."""
    server = Server()
    await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}/stock")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    index = await server.register_namespace("urn:stock")
    nodes = [ua.NodeId(f"n{number}", index) for number in range(n_nodes)]
    for node in nodes:
        await server.nodes.objects.add_variable(node, str(node.Identifier), 0.0)
    async with server:
        print("ready", flush=True)
        ended = asyncio.create_task(asyncio.to_thread(sys.stdin.read))
        planned, count = time.monotonic(), 0
        while not ended.done():
            planned = max(planned + 1 / rate_hz, time.monotonic())
            await asyncio.sleep(planned - time.monotonic())
            count += 1
            now = datetime.now(UTC)
            for offset, node in enumerate(nodes):
                value = ua.Variant(float(count + offset), ua.VariantType.Double)
                await server.write_attribute_value(
                    node, ua.DataValue(value, _GOOD, now, now)
                )


if __name__ == "__main__":
    logging.getLogger("asyncua").setLevel(logging.ERROR)
    asyncio.run(main(int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])))

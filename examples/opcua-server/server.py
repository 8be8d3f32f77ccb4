"""A hardened OPC UA server: a tank whose valve clients may open."""

import asyncio
import sys

from asyncua import ua

from hilserver.opcua.server import HardenedServer
from hilserver.opcua.settings import OpcUaSettings


async def main(endpoint: str) -> None:
    """Serve the tank until it is stopped."""
    server = HardenedServer(OpcUaSettings(endpoint=endpoint))
    await server.init()
    index = await server.register_namespace("urn:example:tank")
    tank = await server.nodes.objects.add_object(index, "Tank")
    level = await tank.add_variable(ua.NodeId("level_m", index), "level_m", 1.0)
    valve = await tank.add_variable(ua.NodeId("valve", index), "valve", 0.0)
    await valve.set_writable()
    async with server:
        print(server.url, flush=True)
        while True:
            outflow_m = 0.01 * await valve.read_value()
            await level.write_value(max(0.0, await level.read_value() - outflow_m))
            server.sample()
            await asyncio.sleep(0.1)


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:] or ["opc.tcp://127.0.0.1:4841/tank"]))

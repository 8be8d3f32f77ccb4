"""Take control, drive 20 rpm straight ahead for three seconds, give control back."""

import asyncio
import sys

from asyncua import Client, ua

ENDPOINT = "opc.tcp://127.0.0.1:4840/hilserver"
FORWARD = [20.0, 20.0, -20.0, -20.0]  # fl, rl, fr, rr: right wheels are mirrored
STOP = [0.0, 0.0, 0.0, 0.0]


async def main(endpoint: str) -> None:
    async with Client(endpoint) as client:
        space = await client.get_namespace_index("urn:hilserver:robot")
        source = client.get_node(f"ns={space};s=control.source")
        setpoints = client.get_node(f"ns={space};s=wheels.setpoints_rpm")
        speed = client.get_node(f"ns={space};s=velocity.linear_m_s")
        await source.write_value("opcua", ua.VariantType.String)
        await asyncio.sleep(0.1)  # outputs are published every 20 ms
        print("control:", await source.read_value(), flush=True)
        for _ in range(6):
            await setpoints.write_value(FORWARD, ua.VariantType.Double)
            await asyncio.sleep(0.5)
            print(f"speed {await speed.read_value():.3f} m/s", flush=True)
        await setpoints.write_value(STOP, ua.VariantType.Double)
        await source.write_value("peer", ua.VariantType.String)
        await asyncio.sleep(0.1)
        print("control:", await source.read_value(), flush=True)


endpoint = sys.argv[1] if len(sys.argv) > 1 else ENDPOINT
try:
    asyncio.run(main(endpoint))
except OSError:
    sys.exit(
        f"{endpoint} does not answer: wait until 'make run' has printed its addresses"
    )

"""The controller of this example as a program of its own: it steps the robot over OPC UA.

Any OPC UA client can do this; `stepping.js` is the same in JavaScript.
"""

import asyncio
import sys

from asyncua import Client, ua

TICKS = 50  # of 1 ms: the controller runs every 50 ms
GOAL_M, GAIN_PER_S, MOST_M_S = 2.0, 2.0, 0.3


async def main(endpoint: str) -> None:
    """Drive to the goal and hold it, for as long as the robot is there."""
    async with Client(endpoint, timeout=60, watchdog_intervall=60) as client:
        ns = await client.get_namespace_index("urn:hilserver:robot")
        names = ("sim.tick", "pose.x_m", "control.mode", "twist.linear_m_s", "methods")
        tick, x, mode, speed, methods = (
            client.get_node(f"ns={ns};s={name}") for name in names
        )
        await mode.write_value(ua.Variant(1, ua.VariantType.Byte))
        done, x_m = 0, 0.0
        while True:
            command = max(-MOST_M_S, min(GAIN_PER_S * (GOAL_M - x_m), MOST_M_S))
            await speed.write_value(ua.Variant(command, ua.VariantType.Double))
            await methods.call_method(
                f"{ns}:Step", ua.Variant(TICKS, ua.VariantType.UInt32)
            )
            done += TICKS
            now = -1
            while (
                now < done - 1
            ):  # both values are of one tick, as they are read together
                now, x_m = await client.read_values([tick, x])


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1]))

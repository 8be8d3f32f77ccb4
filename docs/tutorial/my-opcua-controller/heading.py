"""A controller as a program of its own, an OPC UA client: turns the robot to a heading."""

import asyncio
import math
import sys

from asyncua import Client, ua

CYCLE_TICKS = 50  # of 1 ms
TARGET_RAD, GAIN_PER_S, MAX_TURN_RAD_S = math.pi / 2, 2.5, 1.0


async def main(endpoint: str) -> None:
    """Control the robot until it is switched off."""
    # Patient: by default asyncua gives up when an answer takes longer than a second.
    async with Client(endpoint, timeout=60, watchdog_intervall=60) as client:
        ns = await client.get_namespace_index("urn:hilserver:robot")
        names = ("sim.tick", "pose.yaw_rad", "control.mode", "twist.angular_rad_s")
        tick, yaw, mode, turn = (client.get_node(f"ns={ns};s={n}") for n in names)
        methods = client.get_node(f"ns={ns};s=methods")
        await mode.write_value(1, ua.VariantType.Byte)
        now, yaw_rad = await client.read_values([tick, yaw])
        while True:
            error_rad = math.remainder(TARGET_RAD - yaw_rad, 2 * math.pi)
            command = max(-MAX_TURN_RAD_S, min(GAIN_PER_S * error_rad, MAX_TURN_RAD_S))
            await turn.write_value(command, ua.VariantType.Double)

            # Instead of sleeping for 50 ms: let the robot move on by 50 ms and wait for it.
            cycle = ua.Variant(CYCLE_TICKS, ua.VariantType.UInt32)
            await methods.call_method(f"{ns}:Step", cycle)
            goal = now + CYCLE_TICKS
            while now < goal:  # both values are of one tick, as they are read together
                now, yaw_rad = await client.read_values([tick, yaw])


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1]))

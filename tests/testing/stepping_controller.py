"""A controller in a process of its own, over OPC UA in lockstep: it turns to a heading.

``python stepping_controller.py ENDPOINT [BUG]``; each bug is one that a test has to find.
"""

import asyncio
import math
import sys

from asyncua import Client, ua

TICKS, GOAL_RAD, GAIN_PER_S, MOST_RAD_S = 50, 0.5, 4.0, 0.8


def turn_rate(yaw_rad: float, bug: str) -> float:
    """Return the commanded turn rate [rad/s]."""
    error_rad = math.remainder(GOAL_RAD - yaw_rad, 2 * math.pi)
    if bug == "sign":
        error_rad = -error_rad
    rate = (0.5 if bug == "gain" else GAIN_PER_S) * error_rad
    most_rad_s = 2 * MOST_RAD_S if bug == "limit" else MOST_RAD_S
    return max(-most_rad_s, min(rate, most_rad_s))


async def main(endpoint: str, bug: str = "") -> None:
    """Turn, for as long as the robot is there."""
    async with Client(endpoint, timeout=60, watchdog_intervall=60) as client:
        ns = await client.get_namespace_index("urn:hilserver:robot")
        names = ("sim.tick", "pose.yaw_rad", "control.mode", "twist.angular_rad_s")
        tick, yaw, mode, rate = (client.get_node(f"ns={ns};s={n}") for n in names)
        methods = client.get_node(f"ns={ns};s=methods")
        await mode.write_value(ua.Variant(1, ua.VariantType.Byte))
        now, yaw_rad = await client.read_values([tick, yaw])
        ticks = 500 if bug == "slow" else TICKS
        while True:
            command = turn_rate(yaw_rad, bug)
            await rate.write_value(ua.Variant(command, ua.VariantType.Double))
            goal = now + ticks
            await methods.call_method(
                f"{ns}:Step", ua.Variant(ticks, ua.VariantType.UInt32)
            )
            while now < goal:
                now, yaw_rad = await client.read_values([tick, yaw])


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))

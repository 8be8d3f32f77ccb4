"""An external controller in lockstep: it computes as long as it likes, then the robot moves on.

Pause halts the simulation; Step runs exactly n ticks. So the result does not depend on how
fast this computer, this program or the network is: every run gives the same bits.
"""

import asyncio
import sys

from asyncua import Client, ua

ENDPOINT = "opc.tcp://127.0.0.1:4840/hilserver"
TICKS, PERIOD_S = 50, 0.05  # ticks of 1 ms: the controller runs every 50 ms
GOAL_RAD, GAIN_PER_S, MOST_RAD_S = 1.0, 3.0, 1.0
NEAR_RAD, MOST_STEPS, PATIENCE, PAUSED = 0.01, 500, 5000, 2


class Robot:
    """The few nodes that this controller needs."""

    def __init__(self, client: Client, ns: int) -> None:
        self._client, self._ns = client, ns
        self._methods = client.get_node(f"ns={ns};s=methods")
        self._ticks = 0

    async def call(self, method: str, *arguments: ua.Variant) -> None:
        """Call a method of the daemon."""
        await self._methods.call_method(f"{self._ns}:{method}", *arguments)

    async def write(self, name: str, value: float, kind: ua.VariantType) -> None:
        """Write one input."""
        node = self._client.get_node(f"ns={self._ns};s={name}")
        await node.write_value(ua.Variant(value, kind))

    async def begin(self) -> None:
        """Halt the robot and put it back to the start."""
        await self.call("Pause")
        await self._seen("sim.state", PAUSED)
        await self.call("Reset")  # the inputs, too
        await self.write("control.mode", 1, ua.VariantType.Byte)

    async def step(self) -> float:
        """Let the robot move on by one period of the controller; return its heading [rad]."""
        await self.call("Step", ua.Variant(TICKS, ua.VariantType.UInt32))
        self._ticks += TICKS
        return await self._seen("sim.tick", self._ticks - 1, "pose.yaw_rad")

    async def _seen(self, name: str, wanted: int, other: str = "sim.time_s") -> float:
        """Wait for a value; return another of the same tick, as both are read together."""
        nodes = [self._client.get_node(f"ns={self._ns};s={n}") for n in (name, other)]
        for _ in range(PATIENCE):
            now, beside = await self._client.read_values(nodes)
            if now == wanted:
                return beside
            await asyncio.sleep(0.001)
        raise SystemExit(f"{name} did not become {wanted}")


async def main(endpoint: str) -> None:
    """Turn to a heading, step by step, and print how it went."""
    async with Client(endpoint, timeout=60, watchdog_intervall=60) as client:
        robot = Robot(client, await client.get_namespace_index("urn:hilserver:robot"))
        await robot.begin()
        heading_rad, steps = await robot.step(), 1
        while abs(error := GOAL_RAD - heading_rad) > NEAR_RAD and steps < MOST_STEPS:
            rate = max(-MOST_RAD_S, min(GAIN_PER_S * error, MOST_RAD_S))
            await robot.write("twist.angular_rad_s", rate, ua.VariantType.Double)
            heading_rad, steps = await robot.step(), steps + 1
        print(
            f"heading {heading_rad:.9f} rad after {steps * PERIOD_S:.2f} s of the robot"
        )
        await robot.write("twist.angular_rad_s", 0.0, ua.VariantType.Double)
        await robot.call("Start")


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1] if len(sys.argv) > 1 else ENDPOINT))

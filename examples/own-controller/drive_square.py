"""Drive a square: take control over OPC UA, command a twist, read the pose, give control back."""

import asyncio
import math
import sys

from asyncua import Client, Node, ua

ENDPOINT = "opc.tcp://127.0.0.1:4840/hilserver"
CYCLE_S = 0.02
SIDE_M, SPEED_M_S = 0.6, 0.4
TURN_RAD_S, GAIN_PER_S = 1.0, 3.0


class Robot:
    """The few nodes that this controller needs."""

    def __init__(self, client: Client, namespace: int) -> None:
        self._client = client
        self._pose = [
            self._node(client, namespace, f"pose.{n}")
            for n in ("x_m", "y_m", "yaw_rad")
        ]
        self._linear = self._node(client, namespace, "twist.linear_m_s")
        self._angular = self._node(client, namespace, "twist.angular_rad_s")
        self._mode = self._node(client, namespace, "control.mode")
        self._source = self._node(client, namespace, "control.source")

    @staticmethod
    def _node(client: Client, namespace: int, name: str) -> Node:
        return client.get_node(f"ns={namespace};s={name}")

    async def take_control(self) -> str:
        """Let OPC UA clients command, by twist; return who commanded before."""
        before = await self._source.read_value()
        await self._source.write_value("opcua")
        await self._mode.write_value(ua.Variant(1, ua.VariantType.Byte))
        return before

    async def give_control(self, source: str) -> None:
        """Stand still and let `source` command again."""
        await self.drive(0.0, 0.0)
        await self._source.write_value(source)

    async def pose(self) -> tuple[float, float, float]:
        """Return x [m], y [m] and yaw [rad]."""
        x, y, yaw = await self._client.read_values(self._pose)
        return x, y, yaw

    async def drive(self, linear_m_s: float, angular_rad_s: float) -> None:
        """Command a twist."""
        values = [
            ua.Variant(v, ua.VariantType.Double) for v in (linear_m_s, angular_rad_s)
        ]
        await self._client.write_values([self._linear, self._angular], values)


async def straight(robot: Robot) -> None:
    """Drive one side of the square and stop."""
    x0, y0, _ = await robot.pose()
    while True:
        x, y, _ = await robot.pose()
        if math.hypot(x - x0, y - y0) >= SIDE_M:
            break
        await robot.drive(SPEED_M_S, 0.0)
        await asyncio.sleep(CYCLE_S)
    await robot.drive(0.0, 0.0)


async def turn_to(robot: Robot, target_rad: float) -> None:
    """Turn on the spot to a heading."""
    while True:
        _, _, yaw = await robot.pose()
        error = math.remainder(target_rad - yaw, math.tau)
        if abs(error) < 0.02:
            break
        await robot.drive(0.0, max(-TURN_RAD_S, min(GAIN_PER_S * error, TURN_RAD_S)))
        await asyncio.sleep(CYCLE_S)
    await robot.drive(0.0, 0.0)


async def main(endpoint: str) -> None:
    """Drive one square at the pose where the robot stands."""
    async with Client(endpoint) as client:
        robot = Robot(client, await client.get_namespace_index("urn:hilserver:robot"))
        before = await robot.take_control()
        try:
            _, _, heading = await robot.pose()
            for corner in range(1, 5):
                await straight(robot)
                await turn_to(robot, heading + corner * math.pi / 2)
                x, y, yaw = await robot.pose()
                print(
                    f"corner {corner}: x {x:+.2f} m, y {y:+.2f} m, yaw {yaw:+.2f} rad",
                    flush=True,
                )
        finally:
            await robot.give_control(before)


if __name__ == "__main__":
    endpoint = sys.argv[1] if len(sys.argv) > 1 else ENDPOINT
    try:
        asyncio.run(main(endpoint))
    except OSError:
        sys.exit(
            f"{endpoint} does not answer: wait until the daemon has printed its addresses"
        )

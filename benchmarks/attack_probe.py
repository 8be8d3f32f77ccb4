"""A healthy client that reads at a fixed rate, in a process of its own.

``python -m benchmarks.attack_probe URL``: each line on standard input requests the latencies
of the reads since the previous line, one JSON list [ms] on standard output.
"""

import asyncio
import json
import sys
import time

from asyncua import Client, ua

_PERIOD_S = 0.02
_NODES = ("pose.x_m", "pose.y_m", "pose.yaw_rad", "sim.tick", "wheel.fl.speed_rpm")


async def main(url: str) -> None:
    """Read until standard input ends."""
    latencies_ms: list[float] = []
    async with Client(url, timeout=60, watchdog_intervall=3600) as client:
        index = await client.get_namespace_index("urn:hilserver:robot")
        nodes = [client.get_node(ua.NodeId(name, index)) for name in _NODES]

        async def read() -> None:
            planned = time.monotonic()
            while True:
                planned = max(planned + _PERIOD_S, time.monotonic())
                await asyncio.sleep(planned - time.monotonic())
                began = time.perf_counter()
                await client.read_values(nodes)
                latencies_ms.append((time.perf_counter() - began) * 1e3)

        reading = asyncio.create_task(read())
        while not reading.done():
            line = await asyncio.to_thread(sys.stdin.readline)
            if not line:
                break
            print(json.dumps(latencies_ms), flush=True)
            latencies_ms.clear()
        if reading.done():
            reading.result()
        reading.cancel()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1]))

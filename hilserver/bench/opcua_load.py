"""OPC UA clients that read at a fixed rate: the load under which jitter is measured.

``python -m hilserver.bench.opcua_load URL CLIENTS NODES RATE_HZ`` reads until its standard input
ends and prints the number of reads and of late ones.
"""

import asyncio
import logging
import sys

from asyncua import Client, Node, ua

from hilserver.tasks import first_of

_DEPTH = 6


class Load:
    """Counts the reads of the clients."""

    def __init__(self, url: str, n_nodes: int, rate_hz: float) -> None:
        self._url = url
        self._n_nodes = n_nodes
        self._period_s = 1.0 / rate_hz
        # read requests answered; requests that started a whole period too late
        self.reads = 0
        self.late = 0

    async def client(self, offset: float) -> None:
        """Connect and read until cancelled; `offset` (0 .. 1) spreads the clients in time."""
        async with Client(self._url, timeout=60, watchdog_intervall=3600) as client:
            nodes = await _variables(client.nodes.objects, self._n_nodes)
            loop = asyncio.get_running_loop()
            planned = loop.time() + offset * self._period_s
            while True:
                delay = planned - loop.time()
                if delay < -self._period_s:
                    self.late += 1
                    planned = loop.time()
                await asyncio.sleep(max(0.0, delay))
                await client.read_values(nodes)
                self.reads += 1
                planned += self._period_s


async def _variables(start: Node, n_nodes: int) -> list[Node]:
    """Return `n_nodes` variables of our namespaces, repeated if there are too few."""
    found: list[Node] = []
    level = [start]
    for _ in range(_DEPTH):
        below: list[Node] = []
        for node in level:
            for child in await node.get_children():
                if child.nodeid.NamespaceIndex == 0:
                    continue
                if await child.read_node_class() == ua.NodeClass.Variable:
                    found.append(child)
                else:
                    below.append(child)
                if len(found) >= n_nodes:
                    return found[:n_nodes]
        level = below
    if not found:
        raise RuntimeError("the server offers no variables")
    return (found * (n_nodes // len(found) + 1))[:n_nodes]


async def main(url: str, n_clients: int, n_nodes: int, rate_hz: float) -> None:
    """Run the clients until standard input ends."""
    load = Load(url, n_nodes, rate_hz)
    clients = [load.client(i / n_clients) for i in range(n_clients)]
    try:
        # a failed client is reported, not hidden
        await first_of(asyncio.to_thread(sys.stdin.read), *clients)
    finally:
        print(load.reads, load.late, flush=True)


if __name__ == "__main__":
    logging.getLogger("asyncua").setLevel(logging.ERROR)
    asyncio.run(
        main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4]))
    )

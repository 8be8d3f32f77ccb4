"""A server on the loop of the daemon, which says how long that loop was held.

Usage: python -m tests.security.stall_target <folder>. It prints its address. To each line it
reads it answers with the longest stall since the last line [ms]: the processor time that the loop's
thread used between two callbacks of a probe, so that what other processes take does not count.
"""

import asyncio
import gc
import itertools
import sys
import time
from pathlib import Path

import structlog
import uvloop

from hilserver.core.events import Event, EventKind
from hilserver.opcua import transport
from tests.io.opcua_server.rig import Rig

PROBE_S = 0.001
PATIENCE_S = 120.0


class Probe:
    def __init__(self) -> None:
        self.longest_ms = 0.0

    async def run(self) -> None:
        last_s = time.thread_time()
        while True:
            await asyncio.sleep(PROBE_S)
            now_s = time.thread_time()
            self.longest_ms = max(self.longest_ms, (now_s - last_s) * 1e3)
            last_s = now_s


async def drive(rig: Rig) -> None:
    for number in itertools.count():
        rig.set("pose.x_m", number % 400 * 0.01)
        if number % 10 == 0:
            rig.events.publish(Event(EventKind.STATE, 1, "test", str(number)))
        await asyncio.sleep(0.01)


async def main(folder: Path) -> None:
    # How long others keep a client from sending the rest of a request is no subject here.
    transport.READ_DEADLINE_S = transport.UNREAD_DEADLINE_S = PATIENCE_S
    rig = Rig(folder, max_events_per_s=1000)
    await rig.server.start()
    rig.control.started()
    rig.gate.request("opcua", "opcua")
    gc.collect()
    gc.freeze()  # as the daemon does
    probe = Probe()
    tasks = [asyncio.create_task(drive(rig)), asyncio.create_task(probe.run())]
    reader = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    await loop.connect_read_pipe(
        lambda: asyncio.StreamReaderProtocol(reader), sys.stdin
    )
    print("@", rig.server.url, flush=True)
    while await reader.readline():
        print(f"@ {probe.longest_ms:.3f}", flush=True)
        probe.longest_ms = 0.0
    for task in tasks:
        task.cancel()
    await rig.close()


if __name__ == "__main__":
    # Not on standard output: a pipe that nobody reads would hold the loop.
    log = (Path(sys.argv[1]) / "target.log").open("w", encoding="utf-8")
    structlog.configure(logger_factory=structlog.PrintLoggerFactory(file=log))
    uvloop.run(main(Path(sys.argv[1])))

"""Every period is served: three makes of client, whatever the queue, on the loop of the daemon."""

import asyncio
import itertools
import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
import uvloop
from asyncua import ua

from hilserver.core.events import Event, EventKind
from tests.io.opcua_server.rig import Rig, connected

FOLDER = Path(__file__).parents[1] / "foreign_client"
PERIODS_MS, QUEUES = (50, 100, 250, 500, 1000), (1, 2, 10)
ROWS = list(itertools.product(PERIODS_MS, QUEUES))
WATCHED_S = 6.0
LEAST_SHARE = 0.25
"""Of the periods, or of what the client's best item got where the computer is too busy for them.

Items that died had 0.1 at most.
"""


class Notes:
    def __init__(self) -> None:
        self.at_s: list[float] = []

    def datachange_notification(
        self, node: object, value: object, data: object
    ) -> None:
        self.at_s.append(time.monotonic())

    def event_notification(self, event: object) -> None:
        self.at_s.append(time.monotonic())

    def status_change_notification(self, status: object) -> None:
        pass


async def watch_with_asyncua(rig: Rig) -> dict[str, list[float]]:
    notes = {}
    async with connected(rig) as client:
        for (period_ms, queue), kind in itertools.product(ROWS, ("data", "events")):
            own = notes[f"{kind} {period_ms} {queue}"] = Notes()
            subscription = await client.create_subscription(period_ms, own)
            if kind == "data":
                await subscription.subscribe_data_change(
                    client.path("pose.x_m"), queuesize=queue
                )
            else:
                await subscription.subscribe_events(
                    ua.ObjectIds.Server, queuesize=queue
                )
        await asyncio.sleep(WATCHED_S)
    return {key: own.at_s for key, own in notes.items()}


async def watch_with(rig: Rig, program: str, file: str) -> dict[str, list[float]]:
    command = [
        program,
        str(FOLDER / file),
        rig.server.url,
        str(WATCHED_S),
        json.dumps(ROWS),
    ]
    done = await asyncio.to_thread(
        subprocess.run,
        command,
        cwd=FOLDER,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.strip().splitlines()[-1])


def messages_per_s(at_s: list[float], period_s: float) -> float:
    """Return how often something arrived; 0 if it ended half-way."""
    span_s = at_s[-1] - at_s[0] if at_s else 0.0
    if span_s < WATCHED_S / 2:
        return 0.0
    messages = sum(b - a > period_s / 2 for a, b in itertools.pairwise(at_s))
    return messages / span_s


def poor(rows: dict[str, list[float]]) -> dict[str, float]:
    """Return what a client got too rarely, with its share."""
    periods_s = {key: int(key.split()[1]) / 1e3 for key in rows}
    rates = {key: messages_per_s(at_s, periods_s[key]) for key, at_s in rows.items()}
    best = max(rates.values())
    shares = {
        key: rate / (min(1.0 / periods_s[key], best) or 1.0)
        for key, rate in rates.items()
    }
    return {key: share for key, share in shares.items() if share < LEAST_SHARE}


def test_an_item_that_died_is_poor_however_busy_the_computer_was() -> None:
    for per_s in (20.0, 3.0):
        alive = [n / per_s for n in range(int(6 * per_s))]
        slow = [float(n) for n in range(6)]
        rows = {"data 50 1": alive, "data 50 2": alive[::10], "data 1000 1": slow}
        assert set(poor(rows)) == {"data 50 2"}
    assert set(poor({"data 50 1": []})) == {"data 50 1"}


async def drive(rig: Rig) -> None:
    """Change the value every tick and publish events as fast as the shortest period."""
    for number in itertools.count():
        rig.set("pose.x_m", number % 400 * 0.01)
        rig.events.publish(Event(EventKind.STATE, 1, "test", str(number)))
        await asyncio.sleep(0.02)


async def watch(folder: Path) -> dict[str, dict[str, list[float]]]:
    rig = Rig(folder, max_events_per_s=1000)
    await rig.server.start()
    driving = asyncio.create_task(drive(rig))
    try:
        found = await asyncio.gather(
            watch_with_asyncua(rig),
            watch_with(rig, sys.executable, "periods.py"),
            watch_with(rig, shutil.which("node") or "node", "periods.cjs"),
        )
    finally:
        driving.cancel()
        await rig.close()
    return dict(zip(("asyncua", "python-opcua", "node-opcua"), found, strict=True))


@pytest.mark.node_red
def test_every_period_is_served_to_every_client_whatever_its_queue(
    tmp_path: Path,
) -> None:
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        found = runner.run(watch(tmp_path))
    assert all(len(rows) == 2 * len(ROWS) for rows in found.values())
    assert not {client: few for client, rows in found.items() if (few := poor(rows))}

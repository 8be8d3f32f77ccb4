# ruff: noqa: PLC0415 - the product may be loaded only after the clock was replaced
"""Faults of the product that are planted on purpose, for judges who do not know them.

Each stands for one that the product really had, or for its kind. ``python -m tests.hours.mutants``
counts how many are found, and within how many seeds.
"""

import asyncio
import contextlib
import subprocess
import sys
from collections.abc import AsyncIterator, Callable
from typing import Any

MOST_SEEDS = 1000


def _peer_link_dies() -> None:
    """A foreign cancellation ends the task of a link for good, and nobody says so."""
    from hilserver import tasks
    from hilserver.io.opcua_client import session
    from hilserver.io.peer_link import link

    @contextlib.asynccontextmanager
    async def time_limit(limit_s: float | None) -> AsyncIterator[None]:
        async with asyncio.timeout(limit_s):
            yield

    link.time_limit = session.time_limit = time_limit
    ended = tasks.SupervisedTask._ended

    def _ended(self: Any, task: Any) -> None:
        if not task.cancelled():
            ended(self, task)

    tasks.SupervisedTask._ended = _ended


def _reset_restarts() -> None:
    """A stick that is held drives again after a Reset."""
    from hilserver.core.rest import Rest

    Rest.lets_move = lambda *_: True


def _life_in_cycles() -> None:
    """A subscription may live for any number of cycles, however long a cycle is."""
    from hilserver.opcua import subscriptions

    subscriptions.LONGEST_PUBLISHING_MS = 1e13


def _take_over_keeps_the_lease() -> None:
    """Whoever loses control keeps command and lease for when it returns."""
    from hilserver.core.handover import HandOver
    from hilserver.core.leases import OFFERING, kind_of
    from hilserver.image import Row
    from hilserver.plant.layout import N_SETPOINTS

    take = HandOver.take

    def keeping(self: Any, kind: str, holder: object = None) -> None:
        before = self.owner
        kept = [
            Row(self.leases.place(before, slot), value)
            for slot, (source, value) in self._newest.items()
            if slot < N_SETPOINTS and kind_of(source) == before and before not in OFFERING
        ]
        take(self, kind, holder)
        if kept and self.owner != before:
            self._image.push(kept)

    HandOver.take = keeping


def _filter_kills_the_loop() -> None:
    """An event filter that cannot be evaluated ends the turns of everybody."""
    from hilserver.opcua import monitored_items, rotation

    def compile_where(clause: Any, _types: Any) -> Callable[[Any], bool]:
        def passes(event: Any) -> bool:
            operands = clause.Elements[0].FilterOperands
            return event.field("Severity") > operands[1].Value.Value

        return passes if clause.Elements else lambda _event: True

    monitored_items.compile_where = compile_where
    run = rotation.Rotation._run

    def fragile(self: Any) -> None:
        before, failed = rotation.log.warning, []
        rotation.log = type("Log", (), {"warning": lambda *_, **said: failed.append(said)})
        run(self)
        rotation.log = type("Log", (), {"warning": before})
        if failed and self._handle is not None:
            self._handle.cancel()  # nobody turns any more, and nobody begins again

    rotation.Rotation._run = fragile


def _queues_of_one() -> None:
    """Subscriptions keep only the newest value."""
    from hilserver.opcua.items import ValueItem

    sample = ValueItem.sample

    def newest(self: Any, *given: Any) -> bool:
        is_new = sample(self, *given)
        while len(self.queue) > 1:
            self.queue.popleft()
        return is_new

    ValueItem.sample = newest


def _stale_snapshot() -> None:
    """What a snapshot commanded drives again when it is loaded."""
    from hilserver.core.snapshot import SnapshotStore

    load = SnapshotStore.load

    async def adopting(self: Any, name: str, **_: Any) -> int:
        return await load(self, name)

    SnapshotStore.load = adopting


def _slow_reader_holds_all() -> None:
    """While one client does not read, nobody gets new values."""
    from hilserver.io.opcua_server.server import OpcUaServer

    publish = OpcUaServer.publish

    def waiting(self: Any, frame: Any) -> int:
        clients = () if self._server is None else self._server.bserver.clients
        if any(client.processor.is_congested for client in clients):
            return 0
        return publish(self, frame)

    OpcUaServer.publish = waiting


def _half_open_keep_their_places() -> None:
    """Connections that say nothing are never closed and make no room."""
    from hilserver.opcua.transport import Connection, Listener

    Connection.check_deadlines = lambda *_: None
    Listener.make_room = lambda self, _address: len(self.clients) < self.iserver.max_connections


def _dead_man_never_ends() -> None:
    """A stick whose computer is gone drives on."""
    from hilserver.core.leases import Leases

    limit = Leases.limit

    def unlimited(self: Any, source: str, limit_ms: float | None) -> None:
        limit(self, source, None if source in ("page", "opcua:teleop") else limit_ms)

    Leases.limit = unlimited


MUTANTS = {
    "peer link dies": _peer_link_dies,
    "reset restarts a held stick": _reset_restarts,
    "life in cycles": _life_in_cycles,
    "take-over keeps the lease": _take_over_keeps_the_lease,
    "filter kills the loop": _filter_kills_the_loop,
    "queues of one": _queues_of_one,
    "stale snapshot": _stale_snapshot,
    "slow reader holds all": _slow_reader_holds_all,
    "half-open keep their places": _half_open_keep_their_places,
    "dead-man never ends": _dead_man_never_ends,
}


def plant(name: str) -> None:
    """Plant one of the faults; before the town is started."""
    if name not in MUTANTS:
        raise SystemExit(f"there is no mutant '{name}'; there are {', '.join(MUTANTS)}")
    MUTANTS[name]()


def first_seed(name: str, most: int = MOST_SEEDS) -> tuple[int, str] | None:
    """Return the first seed that shows a mutant, and what the judges say of it."""
    command = [sys.executable, "-m", "tests.hours", f"0:{most}", "--mutant", name, "--until-found"]
    text = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    found = [line for line in text.splitlines() if line.startswith("{")]
    return None if not found else (text.count("\n"), found[0])


if __name__ == "__main__":
    for mutant in sys.argv[1:] or MUTANTS:
        print(mutant, first_seed(mutant), flush=True)

# ruff: noqa: PLC0415 - the product may be loaded only after the clock was replaced
"""Faults of the product that are planted on purpose, for judges who do not know them.

Each stands for one that the product really had, or for its kind. They are planted in a town that
runs; ``python -m tests.hours 0:1000 --mutant all --until-found`` tells how many are found, and how
soon.
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any


def _peer_link_dies(town: Any) -> None:
    """A foreign cancellation ends the task of a link for good, and nobody says so.

    Both happen where an answer comes in the turn of the loop in which the time is up.
    """
    from hilserver import tasks
    from hilserver.io.opcua_client import session
    from hilserver.io.peer_link import link

    @contextlib.asynccontextmanager
    async def time_limit(
        limit_s: float | None, *, at_most_s: float | None = None
    ) -> AsyncIterator[None]:
        async with asyncio.timeout(limit_s):
            yield

    link.time_limit = session.time_limit = time_limit
    ended = tasks.SupervisedTask._ended

    def _ended(self: Any, task: Any) -> None:
        if not task.cancelled():
            ended(self, task)

    tasks.SupervisedTask._ended = _ended
    for job in town.daemon.core.tasks.jobs:
        job.task.remove_done_callback(ended.__get__(job))
        job.task.add_done_callback(job._ended)


def _reset_restarts(_town: Any) -> None:
    """A stick that is held drives again after a Reset."""
    from hilserver.core.rest import Rest

    Rest.lets_move = lambda *_: True


def _reset_starts_controllers(_town: Any) -> None:
    """A controller drives on after a Reset, without a Start."""
    from hilserver.core.rest import Interlock

    Interlock.engage = lambda _: None


def _life_in_cycles(_town: Any) -> None:
    """A subscription may live for any number of cycles, however long a cycle is."""
    from hilserver.opcua import subscriptions

    subscriptions.LONGEST_PUBLISHING_MS = 1e13


def _take_over_keeps_the_lease(_town: Any) -> None:
    """Whoever loses control keeps command and lease for when it returns."""
    from hilserver.core.handover import HandOver
    from hilserver.core.leases import OFFERING, kind_of
    from hilserver.image import Row
    from hilserver.plant.layout import N_COMMANDS

    take = HandOver.take

    def keeping(self: Any, kind: str, holder: object = None) -> None:
        before = self.owner
        kept = [
            Row(self.leases.place(before, slot), value)
            for slot, (source, value) in self._newest.items()
            if slot < N_COMMANDS
            and kind_of(source) == before
            and before not in OFFERING
        ]
        take(self, kind, holder)
        if kept and self.owner != before:
            self._image.push(kept)

    HandOver.take = keeping


def _filter_kills_the_loop(_town: Any) -> None:
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
        rotation.log = type(
            "Log", (), {"warning": lambda *_, **said: failed.append(said)}
        )
        run(self)
        rotation.log = type("Log", (), {"warning": before})
        if failed:
            self.add = self._run = lambda *_: None  # nobody turns any more

    rotation.Rotation._run = fragile


def _queues_of_one(_town: Any) -> None:
    """Subscriptions keep only the newest value."""
    from hilserver.opcua.items import ValueItem

    sample = ValueItem.sample

    def newest(self: Any, *given: Any) -> bool:
        is_new = sample(self, *given)
        while len(self.queue) > 1:
            self.queue.popleft()
        return is_new

    ValueItem.sample = newest


def _stale_snapshot(_town: Any) -> None:
    """What a snapshot commanded drives again when it is loaded."""
    from hilserver.core.inputs import InputGate
    from hilserver.core.snapshot import SnapshotStore

    load = SnapshotStore.load

    async def adopting(self: Any, name: str, **_: Any) -> int:
        return await load(self, name)

    SnapshotStore.load = adopting
    InputGate.end_waiting = InputGate.outdate


def _slow_reader_holds_all(_town: Any) -> None:
    """While one client does not read, nobody gets new values."""
    from hilserver.io.opcua_server.server import OpcUaServer

    publish = OpcUaServer.publish

    def waiting(self: Any, frame: Any) -> int:
        clients = () if self._server is None else self._server.bserver.clients
        if any(client.processor.is_congested for client in clients):
            return 0
        return publish(self, frame)

    OpcUaServer.publish = waiting


def _half_open_keep_their_places(_town: Any) -> None:
    """Connections that say nothing are never closed and make no room."""
    from hilserver.opcua.transport import Connection, Listener

    Connection.check_deadlines = lambda *_: None
    Listener.make_room = lambda self, _address: (
        len(self.clients) < self.iserver.max_connections
    )


def _strangers_keep_the_panels_out(_town: Any) -> None:
    """Connections to the S7 server that say nothing are never closed and make no room."""
    from hilserver.io.places import PlaceKeeper
    from hilserver.io.s7 import server

    take = PlaceKeeper.take

    def taking(self: Any, address: str, end: Any) -> Any:
        return None if len(self) >= self._most else take(self, address, end)

    PlaceKeeper.take = taking
    server.HANDSHAKE_S = 1e6


def _old_blocks(town: Any) -> None:
    """The S7 server answers with the block of its first frame."""
    link = town.daemon.part("s7")
    link._newest()
    link._newest = lambda: link._contents


def _dead_man_never_ends(town: Any) -> None:
    """A stick whose computer is gone drives on."""
    for source in ("page", "opcua:teleop"):
        town.daemon.gate.leases.limit(source, None)


def _snapshots_in_place(_town: Any) -> None:
    """A snapshot has its name while it is still being written."""
    from hilserver.program import whole_file

    @contextlib.contextmanager
    def whole(path: Path) -> Iterator[Path]:
        yield path

    whole_file.whole = whole


def _names_left_to_chance(_town: Any) -> None:
    """A snapshot is accepted as saved before the disk holds its name."""
    from hilserver.program import whole_file

    whole_file.sync_folder = lambda _folder: None


def _half_a_record(_town: Any) -> None:
    """What could not be written to its end stays in the recording, half."""
    from hilserver.logs.writer import WholeFile

    WholeFile.cut = lambda self, size: None


MUTANTS = {
    "reset restarts a held stick": _reset_restarts,
    "reset starts controllers": _reset_starts_controllers,
    "life in cycles": _life_in_cycles,
    "take-over keeps the lease": _take_over_keeps_the_lease,
    "filter kills the loop": _filter_kills_the_loop,
    "queues of one": _queues_of_one,
    "stale snapshot": _stale_snapshot,
    "slow reader holds all": _slow_reader_holds_all,
    "half-open keep their places": _half_open_keep_their_places,
    "strangers keep the panels out": _strangers_keep_the_panels_out,
    "old blocks": _old_blocks,
    "dead-man never ends": _dead_man_never_ends,
    "peer link dies": _peer_link_dies,
    "snapshots in place": _snapshots_in_place,
    "names left to chance": _names_left_to_chance,
    "half a record": _half_a_record,
}


def named(name: str | None) -> Callable[[Any], None] | None:
    """Return what plants a fault in a town; None for none."""
    if name is not None and name not in MUTANTS:
        raise SystemExit(f"there is no mutant '{name}'; there are {', '.join(MUTANTS)}")
    return None if name is None else MUTANTS[name]

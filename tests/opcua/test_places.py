"""Sessions: whoever may drive finds a place, however many others hold."""

import asyncio
import time
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from asyncua.common.utils import ServiceError

from benchmarks.wire import Wire
from hilserver.opcua import transport
from hilserver.opcua.application import Visitor
from hilserver.opcua.places import YIELDS_AFTER_S, SessionPlaces
from hilserver.opcua.transport import Connection
from tests.io.opcua_server.rig import Rig, connected

pytestmark = pytest.mark.asyncio(loop_scope="module")
MOST = 20


@dataclass
class Session:
    """What a place knows of a session."""

    name: str | None = None
    address: str = "192.0.2.1"
    silent_s: float = 0.0
    is_activated: bool = True
    visitor: Visitor = field(default_factory=lambda: Visitor(""))
    is_open: bool = True
    processor: Any = field(default_factory=object)

    @property
    def last_active_s(self) -> float:
        return time.monotonic() - self.silent_s

    @property
    def user(self) -> Any:
        return SimpleNamespace(name=self.name)

    @property
    def holder(self) -> tuple[Any, ...]:
        return (self.name, self.address)

    def close(self) -> None:
        self.is_open = False


def places() -> SessionPlaces:
    return SessionPlaces(MOST, lambda user: (user.name or "").startswith("driver"))


def come_in(sessions: list[Session], newcomer: Session) -> bool:
    """Create and activate; return whether it got a place."""
    judge, newcomer.is_activated = places(), False
    try:
        judge.create([s for s in sessions if s.is_open], newcomer.address)
        sessions.append(newcomer)
        judge.activate([s for s in sessions if s.is_open], newcomer, newcomer.user)
    except ServiceError:
        newcomer.is_open = False
        return False
    newcomer.is_activated = True
    return True


async def test_watchers_leave_a_reserve_to_whoever_may_drive() -> None:
    sessions: list[Session] = []
    got = [come_in(sessions, Session(f"w{i}", f"192.0.2.{i}")) for i in range(2 * MOST)]
    assert got.count(True) == MOST - 2
    assert come_in(sessions, Session("driver", "192.0.2.99"))
    assert not come_in(sessions, Session("watcher", "192.0.2.98"))


@pytest.mark.parametrize("same", ["address", "name"])
async def test_one_address_and_one_user_have_half(same: str) -> None:
    sessions: list[Session] = []
    for i in range(MOST):
        newcomer = Session(f"w{i}", f"192.0.2.{i}")
        setattr(newcomer, same, "192.0.2.7" if same == "address" else "everybody")
        assert come_in(sessions, newcomer) == (i < MOST // 2)
    assert come_in(sessions, Session("other", "192.0.2.200"))


async def test_of_those_who_hold_most_the_longest_idle_yields() -> None:
    crowd = [Session(None, "127.0.0.1", 10.0 + i) for i in range(MOST - 1)]
    lonely = Session("driver", "192.0.2.5", 500.0)
    sessions = [*crowd, lonely]
    assert come_in(sessions, Session("driver", "192.0.2.9"))
    assert lonely.is_open
    assert [s for s in crowd if not s.is_open] == [crowd[-1]]


async def test_nobody_who_asks_for_anything_yields() -> None:
    sessions = [Session(f"driver{i}", "127.0.0.1", 1.0) for i in range(MOST)]
    assert not come_in(sessions, Session("driver", "192.0.2.9"))
    sessions[3].is_activated, sessions[3].silent_s = False, 2.0
    assert come_in(sessions, Session("driver", "192.0.2.9"))
    assert not sessions[3].is_open


async def test_who_has_a_place_of_its_own_takes_none() -> None:
    sessions = [
        Session("driver", "127.0.0.1", visitor=Visitor("", has_own_place=True))
        for _ in range(3 * MOST)
    ]
    assert come_in(sessions, Session("driver", "192.0.2.9"))


async def test_stop_is_heard_beside_held_sessions(tmp_path: Path) -> None:
    """Held by clients like the one that wants to stop: on this computer all look alike."""
    rig = Rig(tmp_path, max_sessions=MOST)
    await rig.server.start()
    rig.control.started()
    try:
        async with AsyncExitStack() as stack:
            for _ in range(MOST):
                wire = await stack.enter_async_context(Wire(rig.server.url))
                await wire.log_in()
            for session in rig.server._server.iserver.sessions.values():
                session.last_active_s -= YIELDS_AFTER_S
            async with connected(rig) as client:
                answer = await client.call("Stop")
                assert answer.StatusCode.is_good()
    finally:
        await rig.close()


async def test_a_connection_that_is_closing_ends_although_its_client_does_not_read(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(transport, "READ_DEADLINE_S", 0.3)
    server = rig.server._server.bserver
    before = len(server.clients)
    async with Wire(rig.server.url) as wire:
        await wire.log_in()
        (protocol,) = server.clients[before:]
        assert isinstance(protocol, Connection)
        wire._writer.transport.pause_reading()
        protocol.transport.write(bytes(64 << 20))
        protocol.transport.close()
        assert not protocol.is_active
        async with asyncio.timeout(60):
            while len(server.clients) > before:  # noqa: ASYNC110
                await asyncio.sleep(0.05)

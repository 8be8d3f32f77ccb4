"""Controllers that the daemon reaches as a client, each over its transport."""

from collections.abc import Iterator
from typing import Any

from hilserver.config.peers import PeerConfig
from hilserver.io.peer_link.link import Peer
from hilserver.io.world import World


def parts(world: World) -> Iterator[Peer]:
    """Yield a link for every configured peer."""
    for index, peer in enumerate(world.config.peers):
        around = {
            "gate": world.gate,
            "events": world.events,
            "read_output": world.read_output,
            "clock": world.clock,
            "line": world.lines[peer.name],
            "tasks": world.tasks,
        }
        with world.at("peers", index):
            yield _link(peer, world, around)


def _link(peer: PeerConfig, world: World, around: dict[str, Any]) -> Peer:
    if peer.is_s7:
        from hilserver.io.s7.peer import S7Peer  # noqa: PLC0415 -- only where it is used

        return S7Peer(peer, world.table, **around)
    from hilserver.io.opcua_client import LinkSecurity, PeerLink  # noqa: PLC0415 -- likewise

    security = LinkSecurity(peer, world.config.opcua, world.folder)
    return PeerLink(peer, security=security, **around)

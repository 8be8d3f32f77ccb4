"""S7 communication (put and get over ISO on TCP): blocks of ours, and controllers as peers.

`wire` has messages as bytes, `blocks` their contents. `server` answers for the part in `link`,
`connection` asks for the part in `peer`.
"""

from collections.abc import Iterator

from hilserver.io.world import Part, World


def parts(world: World) -> Iterator[Part]:
    """Yield the server, if the configuration has one."""
    if world.config.s7.server is not None:
        from hilserver.io.s7.link import S7Link  # noqa: PLC0415 -- only where it is used

        yield S7Link(world.config.s7.server, world)

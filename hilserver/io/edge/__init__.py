"""The databus of an Industrial Edge device: the only room that imports `aiomqtt`."""

from collections.abc import Iterator

from hilserver.io.world import Part, World


def parts(world: World) -> Iterator[Part]:
    """Yield the link, if the configuration has one."""
    if world.config.edge.enabled:
        from hilserver.io.edge.link import EdgeLink  # noqa: PLC0415 -- an extra

        yield EdgeLink(world.config.edge, world)

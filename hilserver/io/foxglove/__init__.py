"""An endpoint for viewers: the only room that imports `foxglove` (package foxglove-sdk)."""

from collections.abc import Iterator

from hilserver.io.world import Part, World


def parts(world: World) -> Iterator[Part]:
    """Yield the endpoint, if the configuration has one."""
    if world.config.foxglove.enabled:
        from hilserver.io.foxglove.endpoint import FoxgloveEndpoint  # noqa: PLC0415 -- an extra

        yield FoxgloveEndpoint(world.config.foxglove, world)

"""The recalibration as a part of the daemon, where the configuration has it."""

from collections.abc import Iterator

from hilserver.io.world import Part, World


def parts(world: World) -> Iterator[Part]:
    """Yield the part; a daemon without it imports nothing of it."""
    if world.config.recalibration.enabled:
        from hilserver.recalibration.part import Recalibration  # noqa: PLC0415

        yield Recalibration(world)

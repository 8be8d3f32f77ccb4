"""Recalibration as a part of the daemon, if the configuration enables it."""

from collections.abc import Iterator

from hilserver.io.world import Part, World


def parts(world: World) -> Iterator[Part]:
    """Yield the part; without it, none of its modules is imported."""
    if world.config.recalibration.enabled:
        from hilserver.recalibration.part import Recalibration  # noqa: PLC0415

        yield Recalibration(world)

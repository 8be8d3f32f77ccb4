"""The endpoint for viewers of a daemon."""

from typing import TYPE_CHECKING

from hilserver.core.clock import UtcClock
from hilserver.daemon.builder import Core
from hilserver.daemon.ros2_node import shape_of

if TYPE_CHECKING:
    from hilserver.io.foxglove import Endpoint


def make_foxglove(core: Core, clock: UtcClock) -> "Endpoint | None":
    """Return the endpoint, None where the configuration has none."""
    config = core.assembly.config.foxglove
    if not config.enabled:
        return None
    from hilserver.io.foxglove import Endpoint, View  # noqa: PLC0415 -- an extra

    view = View(
        table=core.table,
        shape=shape_of(core.assembly),
        hall=core.assembly.composition.hall,
        clock=clock,
        latest=core.image.latest,
        write=core.gate.write,
    )
    return Endpoint(config, view)

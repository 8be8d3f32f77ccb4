"""A part of the daemon: a server, or a link to somebody else."""

from collections.abc import Sequence
from typing import Any

from hilserver.image import Frame
from hilserver.io.link_status import PeerStatus
from hilserver.metrics import Source


class Part:
    """What the daemon starts, shows and stops; a link overrides what it has."""

    section: str  # of the configuration; complaints name it
    label: str  # what people call it
    is_early = False  # starts before the first tick
    # what is known about who is at the other end; OPC UA, page and metrics show it
    status: PeerStatus | None = None
    metrics: Sequence[Source[Any]] = ()  # beside those of every status

    @property
    def address(self) -> str:
        """Where it is reached, or whom it reaches: its line of the banner."""
        return ""

    async def start(self) -> None:
        """Begin; who is at the other end may come later."""

    async def stop(self) -> None:
        """End, also a start that was not completed."""

    def publish(self, frame: Frame) -> object:
        """Show a frame; called by the publish slice, which does not wait."""

    def supervise(self) -> None:
        """Look after what has no event of its own; called by the supervise slice."""

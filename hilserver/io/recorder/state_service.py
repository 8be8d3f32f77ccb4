"""The daemon's side of a recorder's request for a state."""

import asyncio

import structlog

from hilserver.core.snapshot import SnapshotStore
from hilserver.image.state_request import take_request

_log = structlog.get_logger(__name__)


class StateService:
    """Looks for requests and has the plant copy its state; see `image.state_request`."""

    def __init__(self, snapshots: SnapshotStore, image: str) -> None:
        self._snapshots, self._image = snapshots, image
        self._task: asyncio.Task[int] | None = None

    def serve(self) -> None:
        """Begin to serve a request, if there is one; called by the supervise slice."""
        if self._task is not None and not self._task.done():
            return
        self._task = None
        if take_request(self._image):
            self._task = asyncio.create_task(self._snapshots.capture(), name="capture state")
            self._task.add_done_callback(_tell)


def _tell(task: asyncio.Task[int]) -> None:
    if not task.cancelled() and (error := task.exception()) is not None:
        _log.warning("no state for the recorder", error=str(error))

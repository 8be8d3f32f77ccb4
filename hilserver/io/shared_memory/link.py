"""Passes what a program writes in shared memory to the gate."""

import time

from hilserver.config.shared_memory import SharedMemoryConfig
from hilserver.io.arrival import WATCH_S
from hilserver.io.link_status import LinkState, PeerStatus
from hilserver.io.shared_memory.inputs import SharedInputs
from hilserver.io.source import Source
from hilserver.io.world import Part, World
from hilserver.tasks import SupervisedTask


class SharedMemoryLink(Part):
    """The inputs of one program of this computer."""

    section, label = "shared_memory", "memory"
    # `connected` while a program writes; `writes` counts accepted groups
    status: PeerStatus

    def __init__(self, config: SharedMemoryConfig, world: World) -> None:
        self._config = config
        self._world = world
        self.status = PeerStatus("memory", mode="shared memory")
        self._source = Source(
            config.driver,
            "shared memory",
            self.status,
            world.gate,
            world.events.publish,
            fresh=lambda: "shared memory: a program writes",
        )
        self._inputs: SharedInputs | None = None
        self._jobs: list[SupervisedTask] = []

    @property
    def address(self) -> str:
        """The file that a program writes."""
        return self.status.endpoint

    async def start(self) -> None:
        """Make the file; FailedError if that is impossible."""
        inputs = self._inputs = SharedInputs(self._world.image.name, self._world.table)
        self.status.endpoint = str(inputs.path)
        self.status.state = LinkState.CONNECTING
        every = self._world.tasks.every
        self._jobs = [
            every(
                "shared memory: read",
                self._config.poll_ms / 1000.0,
                lambda: self._take(inputs),
            ),
            every("shared memory: watch", WATCH_S, self._look),
        ]

    async def stop(self) -> None:
        """Remove the file."""
        for job in self._jobs:
            job.cancel()
        if self._inputs is not None:
            self._inputs.close()
        self.status.connected = False
        self.status.state = LinkState.STOPPED

    def _take(self, inputs: SharedInputs) -> None:
        values = inputs.news()
        if values is None:
            return
        now_ns = time.monotonic_ns()
        if not self._source.write(values, now_ns, broken=inputs.missing).wrong:
            self._source.staleness.renew(now_ns)
            self.status.input_received_ns.update(dict.fromkeys(values, now_ns))
            self.status.writes += 1

    def _look(self) -> None:
        """Check for silence of the program."""
        status = self.status
        self._source.watch(time.monotonic_ns())
        status.connected = not status.stale
        status.state = LinkState.CONNECTED if status.connected else LinkState.CONNECTING

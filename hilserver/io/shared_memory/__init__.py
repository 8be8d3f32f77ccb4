"""Shared memory for programs in C and C#: they read the process image, and may write inputs.

Reading needs nothing of the daemon. What a program writes lies in a file of its own, `inputs`,
which `link` passes to the gate. `headers` has both as structures.
"""

from collections.abc import Iterator

from hilserver.io.shared_memory.link import SharedMemoryLink
from hilserver.io.world import Part, World


def parts(world: World) -> Iterator[Part]:
    """Yield the inputs, if a program may write any."""
    config = world.config.shared_memory
    if config.grants:
        yield SharedMemoryLink(config, world)

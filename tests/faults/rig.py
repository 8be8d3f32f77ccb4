"""Plant, image, scheduler and faults, without a daemon around them."""

import numpy as np

from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.builder import Pace, build
from hilserver.faults.mail import Mailbox
from hilserver.image import Row


class Rig:
    """One robot in lockstep; tick by tick, in any pacing back end."""

    def __init__(self, backend="virtual", *, silence_ticks=0, folder=None, config=None):
        snapshots = {} if folder is None else {"snapshots": {"folder": str(folder)}}
        self.assembly = assemble_config(
            Config.model_validate(snapshots | (config or {}))
        )
        core = self.core = build(
            self.assembly, Pace(backend=backend, command_limit_ticks=silence_ticks)
        )
        self.table, self.image, self.snapshots = core.table, core.image, core.snapshots
        self.scheduler, self.faults, self.events = (
            core.scheduler,
            core.faults,
            core.events,
        )
        self.mailbox = Mailbox(self.image)
        if backend != "virtual":
            self.scheduler.set_speed(10)

    async def __aenter__(self):
        await self.core.__aenter__()
        return self

    async def __aexit__(self, *_):
        await self.core.__aexit__()

    def write(self, **values):
        rows = []
        for name, value in values.items():
            signal = self.table[name.replace("__", ".")]
            rows += [Row(slot, float(value)) for slot in signal.slots]
        assert self.image.push(rows)

    async def advance(self, n):
        await self.scheduler.advance(n)

    def frames(self, first_tick=0):
        found = [self.image.frame(number) for number in range(self.image.head)]
        return [
            frame for frame in found if frame is not None and frame.tick >= first_tick
        ]

    def series(self, name, first_tick=0):
        slot = self.table.slot(name)
        return np.array([frame.values[slot] for frame in self.frames(first_tick)])

    def status(self, name):
        return int(self.frames()[-1].status[self.table.slot(name)])

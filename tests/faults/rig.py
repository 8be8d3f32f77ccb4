"""Plant, image, scheduler and faults, without a daemon around them."""

import numpy as np

from hilserver.config.root import Config
from hilserver.core.events import EventBus
from hilserver.core.snapshot import SnapshotStore
from hilserver.daemon.assembly import assemble_config
from hilserver.faults import Faults
from hilserver.faults.mail import Mailbox
from hilserver.faults.plan import Planner, ShieldFigures
from hilserver.image import ProcessImage, Row
from hilserver.kernel import compose, limit_silence
from hilserver.plant.layout import P_MAX_RPM, P_RPM_PER_M_S, P_RPM_PER_RAD_S
from hilserver.scheduler import RealtimeSettings, Scheduler
from tests.fakes import image_name


class Rig:
    """One robot in lockstep; tick by tick, in any pacing back end."""

    def __init__(self, backend="virtual", *, silence_ticks=0, config=None):
        settings = {"image": {"ring_frames": 16384}} | (config or {})
        self.assembly = assemble_config(Config.model_validate(settings))
        self.table = self.assembly.table
        composition = self.assembly.composition
        self.image = ProcessImage(
            image_name(),
            self.table,
            live=composition.live_regions,
            fixed=composition.fixed_regions,
            base_period_ns=self.assembly.base_period_ns,
            ring_length=16384,
        )
        self.scheduler = Scheduler(
            base_period_ns=self.assembly.base_period_ns,
            slices=self.assembly.slices,
            step=compose(composition, self.image),
            values=self.image.values,
            words=self.image.words,
            backend=backend,
            realtime=RealtimeSettings(priority=0, lock_memory=False, hold_latency_target=False),
            paused=True,
            freeze_gc=False,
        )
        if backend != "virtual":
            self.scheduler.set_speed(10)
        limit_silence(self.image, silence_ticks)
        p = composition.parameters
        shield = ShieldFigures(p[P_RPM_PER_M_S], p[P_RPM_PER_RAD_S], p[P_MAX_RPM])
        self.events = EventBus()
        self.mailbox = Mailbox(self.image)
        self.faults = Faults(
            self.table,
            self.mailbox,
            Planner(self.table, self.assembly.base_period_ns, shield),
            self.events,
            tick=lambda: self.scheduler.tick,
            lines={},
        )

    async def __aenter__(self):
        await self.scheduler.start()
        return self

    async def __aexit__(self, *_):
        await self.scheduler.stop()
        self.image.close()

    def store(self, folder):
        return SnapshotStore(self.image, folder, dict(self.assembly.identity))

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
        return [frame for frame in found if frame is not None and frame.tick >= first_tick]

    def series(self, name, first_tick=0):
        slot = self.table.slot(name)
        return np.array([frame.values[slot] for frame in self.frames(first_tick)])

    def status(self, name):
        return int(self.frames()[-1].status[self.table.slot(name)])

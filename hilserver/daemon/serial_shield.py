"""Builds the shield of a daemon: what it shows, writes and sets."""

import dataclasses
import math

from hilserver.core.inputs import InputGate
from hilserver.daemon.builder import Core
from hilserver.daemon.supervision import Supervision
from hilserver.image import Row
from hilserver.io.peer_faults import FaultBook
from hilserver.io.shield import ShieldLink, ShieldStatus
from hilserver.io.shield.answer import places
from hilserver.io.shield.device import SOURCE, Device
from hilserver.io.shield.line import Line, open_device, open_pseudo_terminal
from hilserver.io.shield.status import NAME
from hilserver.scheduler import RealtimeSettings


def make_shield(core: Core, supervision: Supervision) -> ShieldLink | None:
    """Return the shield, None where the configuration has none."""
    config, assembly = core.assembly.config.shield, core.assembly
    if not config.enabled:
        return None

    def open_line() -> Line:
        if config.device is not None:
            return open_device(config.device)
        return open_pseudo_terminal(assembly.folder / config.link)

    body = assembly.config.mechatronic.enabled and assembly.config.mechatronic.sensors == "body"
    status = ShieldStatus(NAME)
    faults = FaultBook(status, core.events.publish)
    device = Device(
        config,
        status,
        faults,
        core.gate.write,
        max_rpm=core.table["wheel.fl.setpoint_rpm"].high,
        apply=Gains(core).apply,
    )

    def renew(limit_ns: int) -> None:
        core.gate.leases.limit(SOURCE, limit_ns * 1e-6)
        core.gate.renew(SOURCE)

    return ShieldLink(
        config,
        open_line=open_line,
        image=core.image,
        slots=places(core.table, config.wheels, body=body),
        status=status,
        device=device,
        faults=faults,
        on_silent=lambda: supervision.on_stale(SOURCE),
        renew=renew,
        publish=core.events.publish,
        realtime=_realtime(core),
    )


def _realtime(core: Core) -> RealtimeSettings:
    """Return what the thread of the line asks for: less than the plant's, never its core.

    Without the line's pace a host could keep it busy for ever; it is then a thread like others.
    """
    config = core.assembly.config
    priority = config.scheduler.realtime.priority - 1 if config.shield.pace else 0
    return RealtimeSettings(priority=max(priority, 0))


class Gains:
    """Gains of the wheel speed controller that come in while the robot runs."""

    def __init__(self, core: Core) -> None:
        self._gate: InputGate = core.gate
        self._image, self._table = core.image, core.table
        self._loop, self._period_s = core.assembly.robot.loop, core.assembly.robot.period_s

    def apply(self, k_p: float, k_i: float) -> None:
        """Latch gains [%/rpm], [%/(rpm s)] at the next tick; NaN: as configured.

        Raises
        ------
        ValueError
            If another source has control, or the loop would not be stable.
        """
        if self._gate.owner != SOURCE:
            raise ValueError(f"gains are not taken over: '{self._gate.owner}' has control")
        k_p = self._loop.k_p if math.isnan(k_p) else k_p
        k_i = self._loop.k_i if math.isnan(k_i) else k_i
        loop = dataclasses.replace(self._loop, k_p=k_p, k_i=k_i)
        if k_p < 0.0 or k_i < 0.0 or not loop.spectral_radius(self._period_s) < 1.0:
            raise ValueError(f"gains are not taken over: kp {k_p:g}, ki {k_i:g} are not stable")
        values = {"internal.gains": 1.0, "internal.k_p": k_p, "internal.k_i": k_i}
        self._image.push([Row(self._table.slot(name), value) for name, value in values.items()])

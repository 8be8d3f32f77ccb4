"""Watches the running parts and tells the state machine: who is silent, who is late, who is ready.

Commands that lapse do so in the step; here it is said why, and overruns become events.
"""

from hilserver.core.control import Control
from hilserver.core.events import Event, EventKind
from hilserver.core.inputs import kind_of
from hilserver.core.leases import OFFERING
from hilserver.daemon.builder import Core
from hilserver.monitoring.logging_setup import log_overrun
from hilserver.plant.layout import X_SCALED, X_TWIST_REDUCED
from hilserver.scheduler import OverrunReport

NOTICES = {
    X_TWIST_REDUCED: "the twist has two parts: only the larger one is driven (exclusive_twist)",
    X_SCALED: "the twist asks for more than max_rpm: all wheels are scaled down together",
}
"""Places in the plant's state that say how a command is changed, and what to tell then."""


class Supervision:
    """Judges the parts of one daemon; `run` is called by the supervise slice.

    Attributes
    ----------
    first_ticks_met : bool
        True once the plant met every deadline from one run to the next.
    """

    def __init__(self, core: Core, control: Control) -> None:
        config = core.assembly.config
        self.first_ticks_met = False
        self._period_ms = core.assembly.base_period_ns * 1e-6
        self._plant_state, _ = core.image.region("x")
        self._noticed: set[int] = set()
        self._plant_slice = config.plant.slice
        self._gate, self._events = core.gate, core.events
        self._scheduler = core.scheduler
        self._control = control
        control.before_reset = self._take_lapses
        self._overruns_seen = 0
        self._causes: set[str] = set()
        self._drivers = {"opcua": "the OPC UA client in control"}
        self._drivers |= {driver.source: driver.title for driver in config.drivers}

    def run(self) -> None:
        """Look at everything that has no event of its own."""
        self._take_lapses()
        self._control.supervise()
        self._watch_first_ticks()
        self._watch_command()

    def _watch_command(self) -> None:
        """Tell, once each time it begins, that the robot drives something else than commanded."""
        for place, text in NOTICES.items():
            if not self._plant_state[place]:
                self._noticed.discard(place)
            elif place not in self._noticed:
                self._noticed.add(place)
                self._events.publish(Event(EventKind.STATE, 300, "plant", text))

    def _watch_first_ticks(self) -> None:
        if self.first_ticks_met:
            return
        plant = self._scheduler.statistics.slice(self._plant_slice)
        overruns = plant.late_wakes + plant.long_runs
        self.first_ticks_met = plant.count > 0 and overruns == self._overruns_seen
        self._overruns_seen = overruns

    def on_overrun(self, report: OverrunReport) -> None:
        """Log an overrun with its cause and make it an event."""
        log_overrun(report)
        text = f"slice '{report.slice}': {report.kind} in tick {report.tick}: {report.cause}"
        self._events.publish(Event(EventKind.OVERRUN, 500, report.slice, text))

    def _take_lapses(self) -> None:
        """Say what the step has done with commands that nobody renewed."""
        for lapse in self._gate.leases.lapses():
            self._gate.may_fall_back = False
            stalled_ms = lapse.stalled_ticks * self._period_ms / self._control.speed
            why = f"no fresh command for {lapse.limit_ms:g} ms"
            if 2 * stalled_ms > lapse.limit_ms:
                why = f"our event loop stood still for {stalled_ms:.0f} ms"
            elif lapse.action == "ramp":
                why = f"{self._drivers[lapse.source]} is silent"
            if lapse.action == "ramp":
                cause = lapse.source if kind_of(lapse.source) in OFFERING else None
                self._causes |= {cause} if cause else set()
                self._control.enter_safe(why, cause=cause)
            else:
                done = "set-points zero" + (", drive disabled" * (lapse.action == "device"))
                text = f"{why}: {done}"
                self._events.publish(Event(EventKind.STATE, 500, lapse.source, text))
        for source in tuple(self._causes):
            drives = kind_of(source) == self._gate.owner
            if not drives or not self._gate.leases.has_lapsed(source):
                self._causes.discard(source)
                self._control.clear_cause(source)

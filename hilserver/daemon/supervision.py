"""Watches the running parts and informs the state machine: what is silent, late or ready.

Commands lapse in the step; here the reason is reported, and overruns become events.
"""

from dataclasses import replace

from hilserver.core.control import Control
from hilserver.core.events import Event, EventKind
from hilserver.core.leases import OFFERING, kind_of
from hilserver.daemon.builder import Core
from hilserver.fmu.layout import hangs_since, slow_call
from hilserver.monitoring.logging_setup import log_overrun
from hilserver.plant.layout import State
from hilserver.scheduler import OverrunReport
from hilserver.scheduler.causes import OverrunCause
from hilserver.scheduler.overruns import STALLED

NOTICES = {
    "twist_reduced": "the twist has two parts: only the larger one takes effect (exclusive_twist)",
    "scaled": "the twist asks for more than max_rpm: all wheels are scaled down together",
}
"""Flags in the plant's state for a command that is changed -> the notice."""


class Supervision:
    """Judges the parts of one daemon; `run` is called by the supervise slice."""

    def __init__(self, core: Core, control: Control) -> None:
        config = core.assembly.config
        # True once the plant met every deadline between two calls of `run`
        self.first_ticks_met = False
        self._period_ms = core.assembly.base_period_ns * 1e-6
        self._plant_state = State.of(core.image.region("x")[0])
        self._noticed: set[str] = set()
        self._plant_slice = config.plant.slice
        self._gate = core.gate
        self._events = core.events
        self._scheduler = core.scheduler
        self._control = control
        control.before_reset.append(self._take_lapses)
        self._overruns_seen = 0
        self._causes: set[str] = set()
        self._models = {
            name: (model, core.image.region(f"{name}.a")[1])
            for name, model in core.foreign.items()
        }
        self._drivers = {"opcua": "the OPC UA client in control"}
        self._drivers |= {driver.source: driver.title for driver in config.drivers}

    def run(self) -> None:
        """Check everything that raises no event itself."""
        self._take_lapses()
        # A model of others that fails leads to the safe state.
        for part, (model, a) in self._models.items():
            for news in model.look(a):
                kind = EventKind.STATE if news.is_fault else EventKind.OVERRUN
                self._events.publish(
                    Event(kind, 700 if news.is_fault else 500, part, news.text)
                )
                if news.is_fault:
                    self._control.enter_safe(news.text, cause=None)
        self._control.supervise()
        self._watch_first_ticks()
        # Once each time it begins: the robot drives other than commanded.
        for name, text in NOTICES.items():
            if not self._plant_state[name]:
                self._noticed.discard(name)
            elif name not in self._noticed:
                self._noticed.add(name)
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
        report = self._with_part(report)
        log_overrun(report)
        text = f"slice '{report.slice}': {report.kind} in tick {report.tick}: {report.cause}"
        text += f", {report.part}" if report.part else ""
        self._events.publish(Event(EventKind.OVERRUN, 500, report.slice, text))

    def _with_part(self, report: OverrunReport) -> OverrunReport:
        """Return the report, with the FMU that hangs or took at least half of the time."""
        is_stalled = report.consequence == STALLED
        for name, (_, a) in self._models.items():
            if is_stalled and hangs_since(a):
                return replace(report, part=f"FMU '{name}' has not returned")
            slow_ns = slow_call(a, report.tick)
            if 2 * slow_ns >= report.execution_ns > 0:
                part = f"{slow_ns / 1e6:.3f} ms of it in FMU '{name}'"
                return replace(report, cause=OverrunCause.SLICE, part=part)
        return report

    def _take_lapses(self) -> None:
        """Report what the step has done with commands that were not renewed."""
        for lapse in self._gate.leases.lapses():
            self._gate.may_fall_back = False
            stalled_ms = lapse.stalled_ticks * self._period_ms / self._control.speed
            stalled_ms = max(stalled_ms, lapse.waited_ms)
            why = f"no fresh command for {lapse.limit_ms:g} ms"
            if 2 * stalled_ms > lapse.limit_ms:
                why = f"the daemon's event loop was blocked for {stalled_ms:.0f} ms"
            elif lapse.action == "ramp":
                why = f"{self._drivers[lapse.source]} is silent"
            if lapse.action == "ramp":
                cause = lapse.source if kind_of(lapse.source) in OFFERING else None
                self._causes |= {cause} if cause else set()
                self._control.enter_safe(why, cause=cause)
            else:
                done = "set-points zero" + (
                    ", drive disabled" * (lapse.action == "device")
                )
                text = f"{why}: {done}"
                self._events.publish(Event(EventKind.STATE, 500, lapse.source, text))
        for source in tuple(self._causes):
            drives = kind_of(source) == self._gate.owner
            if not drives or not self._gate.leases.has_lapsed(source):
                self._causes.discard(source)
                self._control.clear_cause(source)

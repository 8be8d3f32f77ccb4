"""Watches the running parts and tells the state machine: who is silent, who is late, who is ready.

Peers that fall silent are acted on while peers have control, also when they get it back; an OPC UA
client in control may be given a limit as well; overruns become events.
"""

from dataclasses import dataclass

from hilserver.core.control import Control
from hilserver.core.events import Event, EventKind
from hilserver.core.inputs import kind_of
from hilserver.daemon.builder import Core
from hilserver.monitoring.logging_setup import log_overrun
from hilserver.plant.layout import X_SCALED, X_TWIST_REDUCED
from hilserver.scheduler import OverrunReport
from hilserver.signals import State

NOTICES = {
    X_TWIST_REDUCED: "the twist has two parts: only the larger one is driven (exclusive_twist)",
    X_SCALED: "the twist asks for more than max_rpm: all wheels are scaled down together",
}
"""Places in the plant's state that say how a command is changed, and what to tell then."""


@dataclass(frozen=True, slots=True)
class Silence:
    """Who is silent, as messages name it, and what is to happen: its ``on_stale``."""

    who: str
    action: str


class Supervision:
    """Judges the parts of one daemon; `run` is called by the supervise slice.

    Attributes
    ----------
    first_ticks_met : bool
        True once the plant met every deadline from one run to the next.
    opcua_stale_after_ms : float or None
        Limit for an OPC UA client in control; a reload may change it.
    """

    def __init__(self, core: Core, control: Control) -> None:
        config = core.assembly.config
        self.first_ticks_met = False
        self.opcua_stale_after_ms = config.control.opcua_stale_after_ms
        self._plant_state, _ = core.image.region("x")
        self._noticed: set[int] = set()
        self._plant_slice = config.plant.slice
        self._gate, self._events = core.gate, core.events
        self._scheduler, self._faults = core.scheduler, core.faults
        self._control = control
        self._overruns_seen = 0
        self._silent: dict[str, Silence] = {}
        self._acted: set[str] = set()

    def run(self) -> None:
        """Look at everything that has no event of its own."""
        self._control.supervise()
        self._watch_first_ticks()
        self._watch_operator()
        self._watch_command()
        self.act_on_silence()

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

    def _watch_operator(self) -> None:
        limit_ms = self.opcua_stale_after_ms
        age_s = self._gate.age_s("opcua")
        if limit_ms is None or age_s is None or self._gate.owner != "opcua":
            return
        if self._faults.timeout_is_dead:
            return
        if age_s * 1e3 > limit_ms and self._control.state is State.RUNNING:
            self._gate.mark_stale("opcua")
            self._control.enter_safe("the OPC UA client in control is silent", cause=None)

    def on_overrun(self, report: OverrunReport) -> None:
        """Log an overrun with its cause and make it an event."""
        log_overrun(report)
        text = f"slice '{report.slice}': {report.kind} in tick {report.tick}: {report.cause}"
        self._events.publish(Event(EventKind.OVERRUN, 500, report.slice, text))

    def on_stale(self, peer: str, action: str) -> None:
        """Take note that a peer has fallen silent; `action` is its ``on_stale``."""
        self.on_silence(f"peer:{peer}", Silence(f"peer '{peer}'", action))

    def on_restored(self, peer: str) -> None:
        """Take note that a peer delivers again."""
        self.on_sound(f"peer:{peer}")

    def on_silence(self, source: str, silence: Silence) -> None:
        """Take note that a source has fallen silent."""
        self._gate.mark_stale(source)
        self._silent[source] = silence
        self.act_on_silence()

    def on_sound(self, source: str) -> None:
        """Take note that a source delivers again."""
        self._silent.pop(source, None)
        self._forgive(source)

    def act_on_silence(self) -> None:
        """Act on silent sources that have control; called whenever control may have moved."""
        if not self._silent or self._faults.timeout_is_dead:
            return
        for source, silence in self._silent.items():
            if self._gate.owner != kind_of(source):
                self._forgive(source)
            elif source not in self._acted:
                self._acted.add(source)
                self._act(source, silence)

    def _act(self, source: str, silence: Silence) -> None:
        if silence.action == "zero":
            self._gate.stop()
        elif silence.action == "device":
            self._gate.stop()
            self._gate.write(source, {"drive.enable": False})
        elif silence.action == "ramp":
            self._control.enter_safe(f"{silence.who} is silent", cause=source)

    def _forgive(self, source: str) -> None:
        self._acted.discard(source)
        self._control.clear_cause(source)

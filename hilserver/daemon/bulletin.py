"""What the daemon writes on the board twice a second: everything that is not a signal."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hilserver import __version__
from hilserver.compiled.histogram import BOUNDS_NS
from hilserver.core.clock import UtcClock
from hilserver.core.control import Control
from hilserver.core.events import EventKind
from hilserver.daemon import figures
from hilserver.daemon.builder import Core
from hilserver.daemon.desk import Desk
from hilserver.daemon.outputs import PublishedOutputs
from hilserver.image.board import Board
from hilserver.io.link_status import PeerStatus
from hilserver.scheduler.metrics import slices_by_name
from hilserver.scheduler.realtime import AuditFinding

EVERY_S = 0.5
EVENTS = 40


@dataclass(frozen=True)
class Surroundings:
    """What links, board and metrics of one daemon are made of."""

    core: Core
    clock: UtcClock
    control: Control
    outputs: PublishedOutputs
    desk: Desk
    audit: Sequence[AuditFinding]
    peers: Callable[[], Sequence[PeerStatus]]

    def content(self) -> dict[str, Any]:
        """Return what the board shows to other processes, in types of JSON."""
        core = self.core
        desk = self.desk
        # The slices, and what the page draws of each
        scheduler = self.core.scheduler
        table = _table(figures.slice_table(scheduler))
        for name, slice_ in slices_by_name(scheduler).items():
            table[name]["margin_last_us"] = slice_.margin_last_ns * 1e-3
            table[name]["latency_counts"] = slice_.latency_counts.tolist()
        acting = [
            {
                "name": f.name,
                "fault": f.fault,
                "place": f.place,
                "acts": f.is_acting,
            }
            for f in core.faults.active()
        ]
        return {
            "version": __version__,
            "monotonic_s": time.monotonic(),  # at which all this was so
            "utc_s": time.time(),
            "state": self.control.state.name.lower(),
            "reason": self.control.reason,
            "waits_for_start": core.gate.interlock.waits,
            "speed": self.control.speed,
            "owner": core.gate.owner,
            "opcua_wrote": bool(
                core.gate.present
            ),  # by a client that is still connected
            "realtime_factor": _number(core.scheduler.statistics.tick.real_time_factor),
            "bounds_us": (BOUNDS_NS / 1000).tolist(),
            "slices": table,
            "peers": _table(figures.peer_table(self.peers())),
            "audit": figures.audit_table(self.audit),
            "faults": acting,
            "gaps": _finite(self.outputs.model_gap()),
            "patch": desk.patches.loaded,
            "patch_notice": desk.patches.notice,
            "scenario": desk.scenarios.view(),
            "recording": desk.recordings.view(),
            "recalibration": desk.recalibration.view(),
            "events": self._events(),
        }

    def _events(self) -> list[dict[str, Any]]:
        """Return the newest events, newest first; the overruns of a slice count as one."""
        now_ns = time.monotonic_ns()
        shown = dict[Any, dict[str, Any]]()
        for event in reversed(self.core.events.recent):
            is_overrun = event.kind == EventKind.OVERRUN
            key = event.source if is_overrun else id(event)
            if key in shown:
                shown[key]["count"] += 1
            elif len(shown) < EVENTS:
                age_s = round((now_ns - event.monotonic_ns) * 1e-9, 1)
                monotonic_s = round(event.monotonic_ns * 1e-9, 3)
                simulated_s = _number(round(event.simulated_s, 6))
                shown[key] = {
                    "age_s": age_s,
                    "monotonic_s": monotonic_s,
                    "simulated_s": simulated_s,
                    "kind": event.kind.value,
                    "severity": event.severity,
                    "source": event.source,
                    "text": event.message[:300],
                    "count": 1,
                }
        return list(shown.values())


class Notice:
    """Writes on the board of the image, no more often than it is read."""

    def __init__(self, of: Surroundings) -> None:
        self._board = Board(of.core.image)
        self._of = of
        self._due_s = 0.0

    def show(self) -> None:
        """Write if it is time; called by the supervise slice."""
        now_s = time.monotonic()
        if now_s >= self._due_s:
            self._due_s = now_s + EVERY_S
            self._board.show(self._of.content())


def _table(table: figures.Table) -> dict[str, dict[str, Any]]:
    return {name: _finite(row) for name, row in table.items()}


def _finite(row: Mapping[str, Any]) -> dict[str, Any]:
    return {name: _number(value) for name, value in row.items()}


def _number(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value

"""The daemon's figures as plain tables: what OPC UA shows and metrics export."""

import math
import time
from collections.abc import Iterable, Mapping

from hilserver.core.inputs import InputGate
from hilserver.image import Frame
from hilserver.io.link_status import PeerStatus
from hilserver.io.world import Figure
from hilserver.scheduler import Scheduler
from hilserver.scheduler.metrics import slices_by_name
from hilserver.scheduler.realtime import AuditFinding
from hilserver.signals import MEASURED, SignalTable
from hilserver.status import GOOD

Table = dict[str, dict[str, Figure]]


def _us(nanoseconds: float | None) -> float | None:
    if nanoseconds is None or math.isnan(nanoseconds):
        return None
    return nanoseconds * 1e-3


def slice_table(scheduler: Scheduler) -> Table:
    """Return latency, execution, margin [us], overruns and pace of every slice."""
    table: Table = {}
    tick = scheduler.statistics.tick
    last, total = (
        None if math.isnan(factor) else factor
        for factor in (tick.real_time_factor, tick.real_time_factor_total)
    )
    for name, f in slices_by_name(scheduler).items():
        latency_us = _us(f.latency_sum_ns / f.count) if f.count else None
        execution_us = _us(f.execution_sum_ns / f.count) if f.count else None
        table[name] = {
            "period_ms": f.period_ns * 1e-6,
            "count": f.count,
            "latency_mean_us": latency_us,
            "latency_max_us": _us(f.latency_max_ns),
            "latency_max_tick": f.latency_max_tick if f.count else None,
            "jitter_us": _us(f.window.deviation_ns),
            "execution_mean_us": execution_us,
            "execution_max_us": _us(f.execution_max_ns),
            "execution_max_tick": f.execution_max_tick if f.count else None,
            "margin_min_us": _us(f.margin_min_ns),
            "margin_min_tick": f.margin_min_tick if f.count else None,
            "late_wakes": f.late_wakes,
            "long_runs": f.long_runs,
            "missed_ticks": f.missed_ticks,
            "realtime_factor": last,
            "realtime_factor_total": total,
        }
    return table


def peer_table(peers: Iterable[PeerStatus]) -> Table:
    """Return what is known about every peer, with None for what is not known yet."""
    now_ns = time.monotonic_ns()
    table: Table = {}
    for p in peers:
        offset_ms = None if p.clock_offset_s is None else p.clock_offset_s * 1e3
        complaints = "; ".join(p.faults.values())
        table[p.name] = {
            "connected": p.connected,
            "state": str(p.state),
            "mode": p.mode,
            "mode_reason": p.mode_reason,
            "stale": p.stale,
            "reconnects": p.reconnects,
            "last_error": p.last_error,
            "round_trip_ms": _ms(p.round_trip.last_ns),
            "one_way_ms": _ms(p.one_way.last_ns),
            "interval_ms": _ms(p.interval.last_ns),
            "clock_offset_ms": offset_ms,
            "granted_publishing_ms": p.granted_publishing_ms,
            "granted_sampling_ms": p.granted_sampling_ms,
            "input_age_s": p.input_age_s(now_ns),
            "sequence_received": p.sequence_received,
            "sequence_missed": p.sequence_missed,
            "writes": p.writes,
            "faults": complaints,
            **p.figures,
        }
    return table


def _ms(nanoseconds: int | None) -> float | None:
    return None if nanoseconds is None else nanoseconds * 1e-6


def audit_table(items: Iterable[AuditFinding]) -> Table:
    """Return the real-time audit: what is fulfilled, and the remedy for what is not."""
    shown = ("ok", "found", "wanted", "remedy")
    return {item.name: {name: getattr(item, name) for name in shown} for item in items}


def model_gap(
    gate: InputGate, table: SignalTable, frame: Frame | None
) -> Mapping[str, float]:
    """Return measured minus simulated of every channel for which measured values come in.

    Both must be Good in `frame`; the difference of two headings lies within half a turn.
    """
    gaps: dict[str, float] = {}
    if frame is None:
        return gaps
    for channel in gate.measured:
        measured = table.slot(f"{MEASURED}{channel}")
        simulated = table.slot(channel)
        if frame.status[measured] == GOOD and frame.status[simulated] == GOOD:
            gap = float(frame.values[measured] - frame.values[simulated])
            gaps[channel] = (
                math.remainder(gap, math.tau) if channel.endswith("yaw_rad") else gap
            )
    return gaps

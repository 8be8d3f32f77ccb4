"""The phases around the plant in every tick: latch inputs, publish outputs, fail safely."""

from typing import Any

from hilserver.compiled import inlined, part
from hilserver.compiled.atomics import load_acquire
from hilserver.image import leases, word
from hilserver.image.layout import REQUEST_LOAD, REQUEST_RESTART
from hilserver.image.leases import (
    Lease,
    adopt_outcome,
    driving,
    end_leases,
    lease_at,
    show_outcome,
)
from hilserver.image.queues import latch_rows
from hilserver.image.requests import serve
from hilserver.image.ring import publish_frame
from hilserver.kernel.changes import drop_changes, take_changes
from hilserver.kernel.modifiers import (
    modifiers,
    modify_inputs,
    modify_outputs,
    restore_true_values,
)
from hilserver.kernel.places import Places
from hilserver.plant.layout import COMMAND_NORMAL, COMMAND_SAFE, Inputs, Outputs
from hilserver.scheduler import faults
from hilserver.signals import State
from hilserver.status import GOOD, UNCERTAIN

SAFE = int(State.SAFE)
FIRST_OUTPUT = Inputs.n_words
END_OF_OUTPUTS = FIRST_OUTPUT + Outputs.n_words
NOTHING, SAVES, RESTORES = range(3)


@inlined
def enter_safe(code: int, at: Places, values: Any, words: Any) -> int:
    """Enter the safe state from the plant's side; the first fault number is kept."""
    if words[word.FIRST_FAULT] == 0:
        words[word.FIRST_FAULT] = code
    values[words[word.FRAME_BASE] + at.command] = COMMAND_SAFE
    return 0


@inlined
def _lapse(lease: Lease, at: Places, values: Any, words: Any) -> None:
    """End a lease that was not renewed in time, according to its policy."""
    lease.lapsed = 1
    lease.stalled = words[word.HEARTBEAT_AGE]
    policy, n = lease.policy, words[word.SETPOINT_SLOTS]
    d = driving(words)
    row = d.values[lease.kind]
    has_effect = policy in (leases.LAPSE_SAFE, leases.LAPSE_DEVICE)
    if policy == leases.LAPSE_SAFE:
        enter_safe(faults.SILENCE, at, values, words)
    elif policy != leases.LAPSE_HOLD or d.up > 0:
        for i in range(n):
            has_effect |= row[i] != 0.0
            row[i] = 0.0
    if policy == leases.LAPSE_DEVICE:
        row[n + 1] = 0.0
    lease.lapses += 1 if has_effect else 0


@part
def drive(now_ns: int, at: Places, values: Any, words: Any) -> None:
    """Renew leases, let overdue ones of the owner lapse, and write the resulting commands."""
    d = driving(words)
    held = words[word.MODIFIERS] > 0 and modifiers(words).timeout_dead != 0
    for number in range(d.count):
        lease = lease_at(number, words)
        if lease.renewed != 0:
            lease.waited = lease.renewed - 1
            lease.since = max(now_ns + 1 - lease.renewed, 1)
            lease.renewed = lease.lapsed = 0
        if held or lease.limit == 0 or lease.since == 0 or lease.lapsed != 0:
            continue
        if lease.kind == d.owner and now_ns - lease.since > lease.limit:
            _lapse(lease, at, values, words)
    show_outcome(values, words)


@inlined
def _take_state(at: Places, values: Any, words: Any) -> None:
    """Show the daemon's state; ramp to zero in the safe state, after a fault and after Stop.

    A replay has both in its input rows and sets the word of the state negative.
    """
    state = words[word.STATE]
    if state < 0:
        return
    is_stopped = load_acquire(words, word.STOP_REQUEST) != words[word.STOP_ACKNOWLEDGED]
    is_safe = is_stopped or state == SAFE or words[word.FIRST_FAULT] != 0
    values[words[word.FRAME_BASE] + at.state] = state
    values[words[word.FRAME_BASE] + at.command] = (
        COMMAND_SAFE if is_safe else COMMAND_NORMAL
    )
    words[word.SAFE_TICKS] = words[word.SAFE_TICKS] + 1 if is_safe else 0


@part
def _drive_on(now_ns: int, values: Any, words: Any) -> None:
    """Continue from a restored state, with its commands or at zero."""
    kind = words[word.REQUEST_KIND]
    if kind in (REQUEST_LOAD, REQUEST_RESTART):
        drop_changes(words[word.REQUEST_TICK], words)
        adopt_outcome(now_ns, values, words)
    if kind == REQUEST_RESTART:
        end_leases(words)


@inlined
def _watch_heartbeat(at: Places, values: Any, words: Any) -> None:
    beat = load_acquire(words, word.HEARTBEAT)
    if beat != words[word.HEARTBEAT_SEEN]:
        words[word.HEARTBEAT_SEEN] = beat
        words[word.HEARTBEAT_AGE] = 0
        return
    words[word.HEARTBEAT_AGE] += 1
    if words[word.HEARTBEAT_AGE] == words[word.HEARTBEAT_LIMIT]:
        enter_safe(faults.COMMUNICATION, at, values, words)


@inlined
def requested(words: Any) -> int:
    """Return the number of the newest snapshot request; later ones wait for the next tick."""
    return int(load_acquire(words, word.REQUEST))


@inlined
def task(request: int, words: Any) -> int:
    """Return what `latch` will do with a request: save the state, restore one, or nothing."""
    if request == words[word.REQUEST_DONE]:
        return NOTHING
    return (
        RESTORES
        if words[word.REQUEST_KIND] in (REQUEST_LOAD, REQUEST_RESTART)
        else SAVES
    )


@part
def latch(
    request: int, tick: int, planned_ns: int, at: Places, values: Any, words: Any
) -> int:
    """Apply parameters, serve a snapshot request, latch the inputs; return the tick to execute.

    The daemon's state is an input like any other, so that a replay shows it at the same ticks.
    """
    if load_acquire(words, word.CHANGES_HEAD) != words[word.CHANGES_TAIL]:
        take_changes(tick, at, values, words)  # before a loaded state brings its own
    served = words[word.REQUEST_DONE]
    tick = serve(request, tick, words)
    restore_true_values(tick, values, words)
    if words[word.REQUEST_DONE] != served:
        _drive_on(planned_ns, values, words)
    _take_state(at, values, words)
    latch_rows(tick, values, words)
    if words[word.LEASES] > 0 and words[word.STATE] >= 0:
        drive(planned_ns, at, values, words)
    modify_inputs(tick, values, words)
    if words[word.LEASES] > 0 and words[word.SAFE_TICKS] > words[word.SAFE_RAMP]:
        values[words[word.FRAME_BASE] + at.enable] = 0.0
    if words[word.HEARTBEAT_LIMIT] > 0:
        _watch_heartbeat(at, values, words)
    return int(tick)


@part
def publish(tick: int, planned_ns: int, at: Places, values: Any, words: Any) -> int:
    """Stamp the working frame and publish it; in the safe state its outputs are Uncertain."""
    frame, status = words[word.FRAME_BASE], words[word.STATUS_BASE]
    values[frame + at.sim] = tick
    values[frame + at.sim + 1] = tick * (words[word.BASE_PERIOD_NS] * 1e-9)
    values[frame + at.sim + 2] = values[frame + at.sim + 3]
    values[frame + at.sim + 4] = values[at.edition]
    if values[frame + at.command] == COMMAND_SAFE:
        for slot in range(FIRST_OUTPUT, END_OF_OUTPUTS):
            if words[status + slot] == GOOD:
                words[status + slot] = UNCERTAIN
    modify_outputs(tick, values, words)
    publish_frame(tick, planned_ns, values, words)
    return 0

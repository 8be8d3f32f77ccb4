"""What surrounds the plant in every tick: latch the inputs, publish the outputs, fail safely."""

from typing import Any

from hilserver.compiled import kernel
from hilserver.compiled.atomics import load_acquire
from hilserver.image import word
from hilserver.image.queues import latch_rows
from hilserver.image.requests import serve_request
from hilserver.image.ring import publish_frame
from hilserver.image.status import GOOD, UNCERTAIN
from hilserver.kernel.modifiers import modify_inputs, modify_outputs, restore_true_values
from hilserver.kernel.places import Places
from hilserver.plant.layout import COMMAND_NORMAL, COMMAND_SAFE, N_U, N_Y
from hilserver.scheduler import faults
from hilserver.signals import State

SAFE = int(State.SAFE)


@kernel()
def enter_safe(code: int, at: Places, values: Any, words: Any) -> int:
    """Go to the safe state from the plant's side; the first fault number is kept."""
    if words[word.FAULT] == 0:
        words[word.FAULT] = code
    values[words[word.FRAME_BASE] + at.command] = COMMAND_SAFE
    return 0


@kernel()
def _take_state(at: Places, values: Any, words: Any) -> None:
    """Show the daemon's state; drive to zero in the safe one, after a fault and after Stop.

    A replay brings both in rows and sets the word of the state negative.
    """
    state = words[word.STATE]
    if state < 0:
        return
    is_stopped = load_acquire(words, word.STOP_REQUEST) != words[word.STOP_ACKNOWLEDGED]
    is_safe = is_stopped or state == SAFE or words[word.FAULT] != 0
    values[words[word.FRAME_BASE] + at.state] = state
    values[words[word.FRAME_BASE] + at.command] = COMMAND_SAFE if is_safe else COMMAND_NORMAL


@kernel()
def _watch_heartbeat(at: Places, values: Any, words: Any) -> None:
    beat = load_acquire(words, word.HEARTBEAT)
    if beat != words[word.HEARTBEAT_SEEN]:
        words[word.HEARTBEAT_SEEN] = beat
        words[word.HEARTBEAT_AGE] = 0
        return
    words[word.HEARTBEAT_AGE] += 1
    if words[word.HEARTBEAT_AGE] == words[word.HEARTBEAT_LIMIT]:
        enter_safe(faults.COMMUNICATION, at, values, words)


@kernel()
def latch(tick: int, at: Places, values: Any, words: Any) -> int:
    """Serve a snapshot request, take the inputs of this tick, return the tick to execute.

    The daemon's state is an input like others, so that a replay shows it at the same ticks.
    """
    tick = serve_request(tick, words)
    restore_true_values(tick, values, words)
    _take_state(at, values, words)
    latch_rows(tick, values, words)
    modify_inputs(tick, values, words)
    if words[word.DRIVE_OFF] != 0:
        values[words[word.FRAME_BASE] + at.enable] = 0.0
    if words[word.HEARTBEAT_LIMIT] > 0:
        _watch_heartbeat(at, values, words)
    return int(tick)


@kernel()
def publish(tick: int, planned_ns: int, at: Places, values: Any, words: Any) -> int:
    """Stamp the working frame and publish it; in the safe state its outputs are Uncertain."""
    frame, status = words[word.FRAME_BASE], words[word.STATUS_BASE]
    values[frame + at.sim] = tick
    values[frame + at.sim + 1] = tick * (words[word.BASE_PERIOD_NS] * 1e-9)
    values[frame + at.sim + 2] = values[frame + at.sim + 3]
    values[frame + at.sim + 4] = values[at.edition]
    if values[frame + at.command] == COMMAND_SAFE:
        for slot in range(N_U, N_U + N_Y):
            if words[status + slot] == GOOD:
                words[status + slot] = UNCERTAIN
    modify_outputs(tick, values, words)
    publish_frame(tick, planned_ns, values, words)
    return 0

"""What surrounds the plant in every tick: latch the inputs, publish the outputs, fail safely."""

import math
from typing import Any

from hilserver.compiled import kernel
from hilserver.compiled.atomics import load_acquire
from hilserver.image import word
from hilserver.image.queues import latch_rows
from hilserver.image.requests import serve_request
from hilserver.image.ring import publish_frame
from hilserver.image.status import GOOD, UNCERTAIN
from hilserver.kernel.modifiers import modify_inputs, modify_outputs, restore_true_values
from hilserver.plant.layout import COMMAND_SAFE
from hilserver.scheduler import faults


@kernel()
def enter_safe(code: int, command_slot: int, values: Any, words: Any) -> None:
    """Go to the safe state from the plant's side; the first fault number is kept."""
    if words[word.FAULT] == 0:
        words[word.FAULT] = code
    values[words[word.FRAME_BASE] + command_slot] = COMMAND_SAFE


@kernel()
def _watch_heartbeat(command_slot: int, values: Any, words: Any) -> None:
    beat = load_acquire(words, word.HEARTBEAT)
    if beat != words[word.HEARTBEAT_SEEN]:
        words[word.HEARTBEAT_SEEN] = beat
        words[word.HEARTBEAT_AGE] = 0
        return
    words[word.HEARTBEAT_AGE] += 1
    if words[word.HEARTBEAT_AGE] == words[word.HEARTBEAT_LIMIT]:
        enter_safe(faults.COMMUNICATION, command_slot, values, words)


@kernel()
def latch(
    tick: int, command_slot: int, enable_slot: int, state_slot: int, values: Any, words: Any
) -> int:
    """Serve a snapshot request, take the inputs of this tick, return the tick to execute.

    The daemon's state is an input like others, so that a replay shows it at the same ticks; a
    replay brings it in rows and sets the word negative.
    """
    tick = serve_request(tick, words)
    restore_true_values(tick, values, words)
    if words[word.STATE] >= 0:
        values[words[word.FRAME_BASE] + state_slot] = words[word.STATE]
    latch_rows(tick, values, words)
    modify_inputs(tick, values, words)
    if words[word.DRIVE_OFF] != 0:
        values[words[word.FRAME_BASE] + enable_slot] = 0.0
    if words[word.HEARTBEAT_LIMIT] > 0:
        _watch_heartbeat(command_slot, values, words)
    return int(tick)


@kernel()
def publish(
    tick: int,
    planned_ns: int,
    command_slot: int,
    first_output: int,
    n_outputs: int,
    sim_slot: int,
    values: Any,
    words: Any,
) -> int:
    """Stamp the working frame and publish it.

    Parameters
    ----------
    first_output, n_outputs : int
        Slots whose quality is Uncertain in the safe state.
    sim_slot : int
        Slot of ``sim.tick``; ``sim.time_s``, ``sim.state`` and ``internal.state`` follow it.
    """
    frame, status = words[word.FRAME_BASE], words[word.STATUS_BASE]
    values[frame + sim_slot] = tick
    values[frame + sim_slot + 1] = tick * (words[word.BASE_PERIOD_NS] * 1e-9)
    values[frame + sim_slot + 2] = values[frame + sim_slot + 3]
    if values[frame + command_slot] == COMMAND_SAFE:
        for slot in range(first_output, first_output + n_outputs):
            if words[status + slot] == GOOD:
                words[status + slot] = UNCERTAIN
    modify_outputs(tick, values, words)
    publish_frame(tick, planned_ns, values, words)
    return 0


@kernel()
def quality(value: float) -> int:
    """Return the status of an own block's output: what is not finite is Uncertain."""
    return GOOD if math.isfinite(value) else UNCERTAIN

"""The control words as Python sees them: plain attributes of an image."""

import numpy as np
from numpy.typing import NDArray

from hilserver.image import word


class _Word:
    """An attribute that lies in shared memory."""

    def __init__(self, index: int) -> None:
        self._index = index

    def __get__(self, owner: "ControlWords", _: object = None) -> int:
        return int(owner.words[self._index])

    def __set__(self, owner: "ControlWords", value: int) -> None:
        owner.words[self._index] = value


class ControlWords:
    """What daemon and plant tell each other beside the signals, by name; `word` says what it means.

    Setting a word of a read-only arena raises a ValueError.
    """

    def __init__(self, words: NDArray[np.int64]) -> None:
        self.words = words

    n_slots = _Word(word.N_SLOTS)
    json_bytes = _Word(word.JSON_BYTES)
    ring_length = _Word(word.RING_LENGTH)
    ring_head = _Word(word.RING_HEAD)
    now_head = _Word(word.NOW_HEAD)
    timed_head = _Word(word.TIMED_HEAD)
    live_base = _Word(word.LIVE_BASE)
    live_length = _Word(word.LIVE_LENGTH)
    shadow_base = _Word(word.SHADOW_BASE)
    request = _Word(word.REQUEST)
    request_kind = _Word(word.REQUEST_KIND)
    request_done = _Word(word.REQUEST_DONE)
    request_tick = _Word(word.REQUEST_TICK)
    state = _Word(word.STATE)
    fault = _Word(word.FIRST_FAULT)
    safe_ramp = _Word(word.SAFE_RAMP)
    leases = _Word(word.LEASES)
    heartbeat = _Word(word.HEARTBEAT)
    heartbeat_limit = _Word(word.HEARTBEAT_LIMIT)
    heartbeat_age = _Word(word.HEARTBEAT_AGE)
    parameters_base = _Word(word.PARAMETERS_BASE)
    parameters_length = _Word(word.PARAMETERS_LENGTH)
    changes_base = _Word(word.CHANGES_BASE)
    changes_head = _Word(word.CHANGES_HEAD)
    changes_tail = _Word(word.CHANGES_TAIL)
    modifiers = _Word(word.MODIFIERS)
    mail_base = _Word(word.MAIL_BASE)
    mail_head = _Word(word.MAIL_HEAD)
    mail_tail = _Word(word.MAIL_TAIL)
    setpoint_slots = _Word(word.SETPOINT_SLOTS)
    command_limit = _Word(word.COMMAND_LIMIT)
    stop_request = _Word(word.STOP_REQUEST)
    stop_acknowledged = _Word(word.STOP_ACKNOWLEDGED)

"""Judges samples and sequence numbers of a peer, and defines why there is no connection."""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

SEQUENCE_MODULUS = 2**32
# a larger step is a restart of the controller, not that many lost numbers
SEQUENCE_JUMP = 10_000


class FaultKind(StrEnum):
    """Ways in which a peer's data can be wrong."""

    NOT_FINITE = "not_finite"
    TEXT_IN_NUMBER = "text_in_number"
    BAD_STATUS = "bad_status"
    NO_VALUE = "no_value"
    MISSING_NODE = "missing_node"
    REFUSED_WRITE = "refused_write"
    UNFIT_OUTPUT = "unfit_output"
    FROZEN_STAMP = "frozen_stamp"
    STAMP_BACKWARDS = "stamp_backwards"
    STAMP_AHEAD = "stamp_ahead"
    SEQUENCE_JUMP = "sequence_jump"
    SEQUENCE_REPEATS = "sequence_repeats"
    SLOW_RATE = "slow_rate"
    SECURITY_POLICY = "security_policy"
    CERTIFICATE = "certificate"
    LOG_IN = "log_in"
    TORN_READ = "torn_read"
    NO_SLOT = "no_slot"
    NO_S7 = "no_s7"
    NO_ROOM = "no_room"


OF_S7: Final = frozenset(
    {FaultKind.TORN_READ, FaultKind.NO_SLOT, FaultKind.NO_S7, FaultKind.NO_ROOM}
)
"""Only S7 has these."""
OF_OPCUA: Final = frozenset(FaultKind) - OF_S7


@dataclass(frozen=True, slots=True)
class SampleVerdict:
    """A usable value, or what is wrong with the sample."""

    value: object = None  # None if it cannot be used
    fault: FaultKind | None = None  # None if it can
    detail: str = ""  # what was seen, for the sentence
    # when its source sampled it, UTC [ns]; None if the protocol does not tell
    stamp_ns: int | None = None


def judge_value(value: object) -> SampleVerdict:
    """Judge a value, or a list of them, with status Good; only finite numbers pass."""
    parts = value if isinstance(value, list | tuple) else [value]
    for part in parts:
        if isinstance(part, bool):
            continue
        if not isinstance(part, int | float):
            detail = f"{type(part).__name__} '{str(part)[:40]}' with status Good"
            return SampleVerdict(fault=FaultKind.TEXT_IN_NUMBER, detail=detail)
        if not math.isfinite(part):
            detail = f"{part} with status Good (often text written into a number)"
            return SampleVerdict(fault=FaultKind.NOT_FINITE, detail=detail)
    return SampleVerdict(
        value=list(parts) if isinstance(value, list | tuple) else value
    )


@dataclass(frozen=True, slots=True)
class SequenceStep:
    """Result for one sequence number."""

    advanced: bool  # new: the controller is alive
    missed: int = 0  # numbers left out since the last one
    fault: FaultKind | None = None  # a jump


class SequenceWatch:
    """Follows a counter that grows by one per cycle and wraps at its modulus."""

    def __init__(self, modulus: int = SEQUENCE_MODULUS) -> None:
        self.last: int | None = None
        self._modulus = modulus

    def observe(self, number: int) -> SequenceStep:
        """Judge the next sequence number."""
        last = self.last
        self.last = number
        if last is None:
            return SequenceStep(advanced=True)
        step = (number - last) % self._modulus
        if step == 0:
            return SequenceStep(advanced=False)
        if step > SEQUENCE_JUMP:
            return SequenceStep(advanced=True, fault=FaultKind.SEQUENCE_JUMP)
        return SequenceStep(advanced=True, missed=step - 1)


REFUSED_PAUSE_S = 2.0
LOG_IN_PAUSE_S = 20.0  # servers lock an account after a few failures a minute


class LinkLostError(Exception):
    """The session ended; the message has the reason."""


class LinkRefusedError(Exception):
    """There is no session, and another attempt without a change would fail, too."""

    def __init__(self, kind: FaultKind, subject: str, sentence: str) -> None:
        super().__init__(sentence)
        self.kind = kind
        self.subject = subject  # distinguishes reasons of one kind
        # shortest time to the next attempt [s]
        self.pause_s = LOG_IN_PAUSE_S if kind is FaultKind.LOG_IN else REFUSED_PAUSE_S


def refusal_in(error: BaseException) -> LinkRefusedError | None:
    """Return the refusal that ended a session or an attempt, None if it was something else."""
    if isinstance(error, BaseExceptionGroup):
        return next(filter(None, map(refusal_in, error.exceptions)), None)
    return error if isinstance(error, LinkRefusedError) else None

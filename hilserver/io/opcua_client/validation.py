"""Judges single samples and sequence numbers of a peer: pure functions and a counter."""

import math
from dataclasses import dataclass
from enum import StrEnum

from asyncua import ua

SEQUENCE_MODULUS = 2**32
SEQUENCE_JUMP = 10_000
"""A larger step is a restart of the controller, not that many lost numbers."""


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


@dataclass(frozen=True, slots=True)
class Verdict:
    """A usable value, or what is wrong with the sample.

    Attributes
    ----------
    value : bool, int, float, list of those, or None
        None when it cannot be used.
    fault : FaultKind or None
        None when it can.
    detail : str
        What was seen, for the sentence.
    """

    value: object = None
    fault: FaultKind | None = None
    detail: str = ""


def judge(sample: ua.DataValue) -> Verdict:
    """Judge one sample; only status Good and finite numbers pass."""
    status = sample.StatusCode
    if status is not None and not status.is_good():
        kind = FaultKind.BAD_STATUS
        if status.value in (ua.StatusCodes.BadNodeIdUnknown, ua.StatusCodes.BadNodeIdInvalid):
            kind = FaultKind.MISSING_NODE
        return Verdict(fault=kind, detail=f"status {status.name}")
    value = sample.Value.Value if sample.Value is not None else None
    if value is None:
        return Verdict(fault=FaultKind.NO_VALUE, detail="status Good without a value")
    parts = value if isinstance(value, list | tuple) else [value]
    for part in parts:
        if isinstance(part, bool):
            continue
        if not isinstance(part, int | float):
            detail = f"{type(part).__name__} '{str(part)[:40]}' with status Good"
            return Verdict(fault=FaultKind.TEXT_IN_NUMBER, detail=detail)
        if not math.isfinite(part):
            detail = f"{part} with status Good (often text written into a number)"
            return Verdict(fault=FaultKind.NOT_FINITE, detail=detail)
    return Verdict(value=list(parts) if isinstance(value, list | tuple) else value)


@dataclass(frozen=True, slots=True)
class SequenceStep:
    """What one sequence number says.

    Attributes
    ----------
    advanced : bool
        It is new: the controller is alive.
    missed : int
        Numbers left out since the last one.
    fault : FaultKind or None
        A jump.
    """

    advanced: bool
    missed: int = 0
    fault: FaultKind | None = None


class SequenceWatch:
    """Follows a counter that grows by one per cycle and may wrap at 2**32."""

    def __init__(self) -> None:
        self.last: int | None = None

    def observe(self, number: int) -> SequenceStep:
        """Judge the next sequence number."""
        last, self.last = self.last, number
        if last is None:
            return SequenceStep(advanced=True)
        step = (number - last) % SEQUENCE_MODULUS
        if step == 0:
            return SequenceStep(advanced=False)
        if step > SEQUENCE_JUMP:
            return SequenceStep(advanced=True, fault=FaultKind.SEQUENCE_JUMP)
        return SequenceStep(advanced=True, missed=step - 1)

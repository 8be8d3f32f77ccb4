"""Judges single samples of an OPC UA peer, and reads their stamps without rounding."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

from asyncua import ua

from hilserver.io.peer_link.samples import FaultKind, Verdict, judge_value

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND = timedelta(microseconds=1)


def utc_ns_of(stamp: datetime | None) -> int | None:
    """Return UTC [ns since 1970] of an OPC UA time stamp; None where there is none."""
    if stamp is None:
        return None
    if stamp.tzinfo is None:
        stamp = stamp.replace(tzinfo=UTC)
    return (stamp - _EPOCH) // _MICROSECOND * 1000


def judge(sample: ua.DataValue) -> Verdict:
    """Judge one sample; only status Good and finite numbers pass."""
    return replace(_judged(sample), stamp_ns=utc_ns_of(sample.SourceTimestamp))


def _judged(sample: ua.DataValue) -> Verdict:
    status = sample.StatusCode
    if status is not None and not status.is_good():
        kind = FaultKind.BAD_STATUS
        if status.value in (ua.StatusCodes.BadNodeIdUnknown, ua.StatusCodes.BadNodeIdInvalid):
            kind = FaultKind.MISSING_NODE
        return Verdict(fault=kind, detail=f"status {status.name}")
    value = sample.Value.Value if sample.Value is not None else None
    if value is None:
        return Verdict(fault=FaultKind.NO_VALUE, detail="status Good without a value")
    return judge_value(value)

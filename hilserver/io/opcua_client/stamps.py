"""OPC UA DateTime to integer nanoseconds of UTC, without the rounding of float timestamps."""

from datetime import UTC, datetime, timedelta

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND = timedelta(microseconds=1)


def utc_ns_of(stamp: datetime | None) -> int | None:
    """Return UTC [ns since 1970] of an OPC UA time stamp; None where there is none."""
    if stamp is None:
        return None
    if stamp.tzinfo is None:
        stamp = stamp.replace(tzinfo=UTC)
    return (stamp - _EPOCH) // _MICROSECOND * 1000

"""Shared by the thread of the serial line and the event loop: an int64 array, by index."""

from typing import Final

from hilserver.compiled.histogram import N_BUCKETS

PENDING: Final = 8
"""Responses that may wait for the line; a host that asks faster than it reads loses the rest."""
WAITING_MOST: Final = 256  # requests that may wait for the event loop, a power of two
STAMPS: Final = 4096  # writes whose times are kept, a power of two
ALONE: Final = 1  # flag of a request that stood alone and has a wrong end

(
    STOP,
    CRC,  # 1: variant crc
    BYTE,  # [ns] that one byte lasts
    DELAY,  # [ns] from a request to its response
    PAUSE,  # [ns] of silence that ends a burst
    LIMIT,  # [ns] of silence that ends a command
    IS_PTY,
    RAW,  # 1: the IMU's raw values, 0: quaternion
    # framing
    FILL,
    IN_STEP,
    CLEAN,  # 1: the frame began after a pause
    # the line
    RX_COUNT,
    RX_DUE,  # [ns] when the bytes that were read have come in
    RX_LAST,  # [ns] when the newest byte had come in
    EMPTY,  # [ns] when nothing was last seen waiting on the line
    MORE,  # 1: more bytes were waiting when the newest were read
    TX_COUNT,
    TX_DUE,  # [ns] before which the response must not be seen
    TX_LAST,  # [ns] when the newest response was written
    PENDING_HEAD,
    PENDING_TAIL,
    RING_HEAD,
    RING_TAIL,
    CONNECTED,
    # counters
    BYTES,
    SKIPPED,
    REQUESTS,
    UNTERMINATED,
    RESPONSES,
    UNANSWERED,  # too many were waiting
    UNREAD,  # bytes of responses that did not fit into the line
    UNHEARD,  # requests that the event loop never saw
    LATE_SUM,  # [ns]
    LATE_MAX,  # [ns]
    LATE_COUNTS,
) = range(35)
PENDING_ROWS: Final = LATE_COUNTS + N_BUCKETS  # PENDING x (command, due)
# WAITING_MOST x (command, flags, payload, time)
RING_ROWS: Final = PENDING_ROWS + 2 * PENDING
STAMP_ROWS: Final = RING_ROWS + 4 * WAITING_MOST  # STAMPS x (due, written)
N_WORDS: Final = STAMP_ROWS + 2 * STAMPS

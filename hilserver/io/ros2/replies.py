"""Replies as rmw_fastrtps recognises them: with the identity of the request in RTPS inline QoS.

Cyclone DDS neither shows the number of a request nor writes that mark. So requests are counted by
their writer, which numbers them from 1, and the reply is one RTPS message (RTPS 2.3, section 8.3),
written here in the name of the service's own writer, which itself writes nothing. Nothing repeats a
message that is lost on a network. A client that has called before this daemon started gets no
answers: its count began with another daemon.
"""

import contextlib
import socket
import struct
import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Final, NamedTuple

from hilserver.io.ros2.neighbours import Neighbours, RemoteEndpoint, plain
from hilserver.io.ros2.participant import Arrival, Out

_MAGIC: Final = b"RTPS\x02\x03\x01\x10"  # protocol 2.3, vendor Cyclone DDS
_INFO_TS, _INFO_DST, _DATA = 0x09, 0x0E, 0x15
_LITTLE, _INLINE_QOS, _PAYLOAD = 0x01, 0x02, 0x04
_TO_INLINE_QOS: Final = 16  # bytes from here to the inline QoS
_RELATED: Final = (0x0083, 0x800F)  # as the standard has it, and as Fast DDS 2 reads it
_SENTINEL: Final = struct.pack("<HH", 1, 0)
_PREFIX: Final = 12  # bytes of a GUID that name the participant
MOST_COUNTED: Final = 10_000
MOST_WAITING: Final = 100
KNOWN_WITHIN_S: Final = 2.0


class _Reply(NamedTuple):
    """A reply to a client whose reader is not known yet."""

    end_s: float
    service: Out
    request: Arrival
    number: int
    cdr: bytes


class Replies:
    """Counts requests and sends replies, for every service of the node.

    Parameters
    ----------
    given_up : callable
        Takes the topic of a reply that will not be sent, and a sentence.
    """

    def __init__(
        self,
        neighbours: Neighbours,
        given_up: Callable[[str, str], None],
        *,
        local: bool,
    ) -> None:
        self._neighbours, self._local = neighbours, local
        self._given_up = given_up
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._asked: Counter[int] = Counter()  # requests by writer
        # replies by reader, each of which counts from 1
        self._sent: Counter[bytes] = Counter()
        self._waiting: deque[_Reply] = deque(maxlen=MOST_WAITING)

    def number(self, request: Arrival) -> int:
        """Return the number that the client has given to a request; each is to be counted once."""
        if len(self._asked) >= MOST_COUNTED:
            self._asked.clear()
        self._asked[request.writer] += 1
        return self._asked[request.writer]

    def send(self, service: Out, request: Arrival, number: int, cdr: bytes) -> None:
        """Reply to the client that has sent a request, as soon as its reader is known."""
        if len(self._waiting) == MOST_WAITING:
            self._give_up(self._waiting[0])
        end_s = time.monotonic() + KNOWN_WITHIN_S
        self._waiting.append(_Reply(end_s, service, request, number, cdr))
        self.send_waiting()

    def send_waiting(self) -> None:
        """Send what can be sent, and give up what has waited for too long."""
        if not self._waiting:
            return
        # A request may come before the news of its client, and of the reader that it has made.
        self._neighbours.look()
        now_s = time.monotonic()
        waiting = [reply for reply in self._waiting if not self._is_sent(reply)]
        self._waiting.clear()
        for reply in waiting:
            if reply.end_s > now_s:
                self._waiting.append(reply)
            else:
                self._give_up(reply)

    def _give_up(self, reply: _Reply) -> None:
        topic = reply.service.subject.topic
        service = plain(topic).removesuffix("Reply")
        self._given_up(
            topic,
            f"an answer of {service} was not sent, as its client was not discovered within"
            f" {KNOWN_WITHIN_S:g} s: call again; if that does not help, start the client anew",
        )

    def _is_sent(self, reply: _Reply) -> bool:
        client = self._neighbours.writers.get(reply.request.writer)
        neighbour = self._neighbours.participant_of(reply.request.writer)
        if client is None or neighbour is None:
            return False
        places = set(neighbour.addresses)
        if self._local:
            places = {("127.0.0.1", port) for _, port in places}
        topic = reply.service.subject.topic
        readers = self._neighbours.replies_to(topic, client.participant)
        for reader in readers:
            self._sent[reader] += 1
            message = _message(
                reply.service.gid,
                reader,
                self._sent[reader],
                client,
                reply.number,
                reply.cdr,
            )
            for place in places:
                # not every address of it is within our reach
                with contextlib.suppress(OSError):
                    self._socket.sendto(message, place)
        return bool(readers and places)

    def close(self) -> None:
        """Give the socket back."""
        self._socket.close()


def _message(
    writer: bytes,
    reader: bytes,
    sequence: int,
    client: RemoteEndpoint,
    number: int,
    cdr: bytes,
) -> bytes:
    """Return an RTPS message with one sample; GUIDs have 16 bytes."""
    seconds, nanoseconds = divmod(time.time_ns(), 10**9)
    stamp = struct.pack("<II", seconds, (nanoseconds << 32) // 10**9)
    related = client.gid + _sequence(number)
    marks = b"".join(
        struct.pack("<HH", mark, len(related)) + related for mark in _RELATED
    )
    body = struct.pack("<HH", 0, _TO_INLINE_QOS) + reader[_PREFIX:] + writer[_PREFIX:]
    body += _sequence(sequence) + marks + _SENTINEL + cdr
    return (
        _MAGIC
        + writer[:_PREFIX]
        + _submessage(_INFO_DST, 0, reader[:_PREFIX])
        + _submessage(_INFO_TS, 0, stamp)
        + _submessage(_DATA, _INLINE_QOS | _PAYLOAD, body + bytes(-len(body) % 4))
    )


def _submessage(kind: int, flags: int, body: bytes) -> bytes:
    return struct.pack("<BBH", kind, _LITTLE | flags, len(body)) + body


def _sequence(number: int) -> bytes:
    return struct.pack("<iI", number >> 32, number & 0xFFFFFFFF)

"""Services over DDS: a topic of requests and one of replies.

With rmw_cyclonedds the identity of a request is part of the message and returns with the reply.
rmw_fastrtps carries it in RTPS inline QoS, see `replies`.
"""

import struct
from typing import Any, Final

from hilserver.config.ros2 import Ros2Config
from hilserver.io.ros2.participant import Arrival, In, Out, Participant
from hilserver.io.ros2.replies import Replies
from hilserver.io.ros2.wire import WireTypes
from hilserver.ros.flavours import Served
from hilserver.ros.incoming import Answer
from hilserver.ros.qos import Qos
from hilserver.ros.robot import RosFrame
from hilserver.ros.types import Types

HEADER_BYTES: Final = 4
WAITING: Final = 1000
"""Requests that may wait to be read; one that is dropped would spoil the count of its client's."""
IDENTITY: Final = struct.calcsize("<Qq")


class RosService:
    """One service of the node."""

    def __init__(
        self,
        served: Served,
        config: Ros2Config,
        types: Types,
        wire: WireTypes,
        participant: Participant,
    ) -> None:
        self.name = config.full_name(served.name)
        self._served, self._types = served, types
        self._identity = IDENTITY if config.rmw == "cyclonedds" else 0
        parts = f"{served.type}_Request", f"{served.type}_Response"
        request, response = (
            wire.make(part, with_identity=bool(self._identity)) for part in parts
        )
        request_hash, response_hash = (types.hash(part) for part in parts)
        asked = Qos(depth=WAITING)
        self._reader = participant.reader(
            f"rq{self.name}Request", request, asked, request_hash
        )
        self._writer = participant.writer(
            f"rr{self.name}Reply", response, Qos(), response_hash
        )

    @property
    def endpoints(self) -> tuple[In, Out]:
        """Reader of the requests, writer of the replies."""
        return self._reader, self._writer

    def take(self) -> list[Arrival]:
        """Return the requests that came in."""
        return self._reader.take()

    def understand(self, robot: RosFrame, request: Arrival) -> Answer:
        """Return what to write and what to answer.

        ValueError if it is not a request of this service.
        """
        body = request.cdr[:HEADER_BYTES] + request.cdr[HEADER_BYTES + self._identity :]
        message = self._types.decode(body, f"{self._served.type}_Request")
        return self._served.serve(robot, message)

    def answer(
        self, request: Arrival, number: int, response: Any, replies: Replies
    ) -> None:
        """Reply to the request that has this number at its client."""
        cdr = self._types.encode(response)
        if self._identity:
            identity = request.cdr[HEADER_BYTES : HEADER_BYTES + self._identity]
            self._writer.write(cdr[:HEADER_BYTES] + identity + cdr[HEADER_BYTES:])
        else:
            replies.send(self._writer, request, number, cdr)

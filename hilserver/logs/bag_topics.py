"""The topics of a bag that hilserver writes: every signal as float64, plus EduArt's topics."""

from typing import Any, Final

import numpy as np

from hilserver.logs.changes import TOPIC as CHANGES
from hilserver.logs.mcap_writer import TOPIC as FRAMES
from hilserver.logs.message import SCHEMA_NAME
from hilserver.ros import outgoing
from hilserver.ros.flavours import EXTRAS, FLAVOURS, Published
from hilserver.ros.robot import Odometer, RosFrame, Shape
from hilserver.ros.types import Types

__all__ = ["CHANGES", "FRAMES", "FRAME_TYPE", "RUN", "RUN_TYPE", "STATES", "STATE_TYPE"]

FRAME_TYPE: Final = SCHEMA_NAME
RUN, RUN_TYPE = "/hilserver/run", "std_msgs/msg/String"
"""Origin of the recording, as JSON; ``order``: the signals in the order of the frames."""
STATES, STATE_TYPE = "/hilserver/state", "hilserver/msg/State"  # states to replay from
STATE_TEXT: Final = "int64 segment\nint64 tick\nint64[] words\n"

TARGET: Final = Published(
    "iotbot/rpm", "iotbot_interface/msg/RotationSpeed", outgoing.rpm_target
)
EDUART: Final[tuple[Published, ...]] = (
    TARGET,
    *FLAVOURS["iotbot_shield"].published,
    EXTRAS["pose_stamped"],
)
"""As a recorder next to the real robot writes them: float32, 50 times a second."""


def absolute(topic: str) -> str:
    """Return a topic's name in a bag."""
    return topic if topic.startswith("/") else f"/{topic}"


class Eduart:
    """Turns frames into EduArt's messages, as far as the recorded signals allow."""

    def __init__(self, types: Types, names: list[str], period_ns: int) -> None:
        nowhere = Shape(
            1.0, 1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0
        )  # dimensions are in none of these messages
        self._robot = RosFrame(types, nowhere, Odometer(nowhere))
        self._names = names
        self._robot.values = dict.fromkeys(names, 0.0)
        self.topics = [
            published for published in EDUART if self._is_possible(published)
        ]
        self.every = {
            published.topic: max(
                1, round((published.period_s or 1.0) * 1e9 / period_ns)
            )
            for published in self.topics
        }

    def _is_possible(self, published: Published) -> bool:
        try:
            return bool(list(published.make(self._robot)))
        except KeyError:
            return False

    def messages(
        self, tick: int, stamp_ns: int, values: np.ndarray
    ) -> list[tuple[str, Any]]:
        """Return topic and message of everything that is due at a tick."""
        due = [p for p in self.topics if tick % self.every[p.topic] == 0]
        if not due:
            return []
        self._robot.values = dict(zip(self._names, values.tolist(), strict=True))
        self._robot.stamp_ns = stamp_ns
        return [(p.topic, message) for p in due for message in p.make(self._robot)]

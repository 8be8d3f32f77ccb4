"""The topics of a bag that hilserver writes: every signal as float64, plus EduArt's topics."""

import math
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


_MADE_UP: Final = {"iotbot/temperature": "shield.temperature_degc"}
"""Signals for which the live node has a substitute, and a bag has none."""


class _Row(dict[str, float]):
    """The values of a frame; what was not measured is not there."""

    def __getitem__(self, name: str) -> float:
        value = super().__getitem__(name)
        if math.isnan(value):
            raise KeyError(name)
        return value


class Eduart:
    """Turns frames into EduArt's messages, as far as the recorded signals allow.

    A message exists only where its data do, and no more often than its source measures: the shield
    sends everything at its own rate, but the tag comes from a node of its own.
    """

    def __init__(
        self,
        types: Types,
        names: list[str],
        period_ns: int,
        tag_ticks: int | None = None,
    ) -> None:
        nowhere = Shape(
            1.0, 1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0
        )  # dimensions are in none of these messages
        self._robot = RosFrame(types, nowhere, Odometer(nowhere))
        self._names = names
        zeros = _Row(dict.fromkeys(names, 0.0))
        self.topics = [p for p in EDUART if self._made(p, zeros)]
        self.every = {
            published.topic: max(
                1, round((published.period_s or 1.0) * 1e9 / period_ns)
            )
            for published in self.topics
        }
        tag = EXTRAS["pose_stamped"].topic
        if tag_ticks is not None and tag in self.every:
            self.every[tag] = tag_ticks
        self._latest: dict[str, int] = {}

    def _made(self, published: Published, row: _Row) -> list[Any]:
        """Return the messages of a topic; none if the frame lacks their data."""
        self._robot.values = row
        try:
            needed = _MADE_UP.get(published.topic)
            if needed is not None:
                row[needed]
            return list(published.make(self._robot))
        except KeyError:
            return []

    def _is_due(self, topic: str, tick: int) -> bool:
        """Return whether a period of a topic has begun: recordings may leave out ticks."""
        every = self.every[topic]
        before = self._latest.get(topic, (tick - 1) // every)
        self._latest[topic] = tick // every
        return self._latest[topic] != before

    def messages(
        self, tick: int, stamp_ns: int, values: np.ndarray
    ) -> list[tuple[str, Any]]:
        """Return topic and message of everything that is due at a tick."""
        due = [p for p in self.topics if self._is_due(p.topic, tick)]
        if not due:
            return []
        row = _Row(zip(self._names, values.tolist(), strict=True))
        self._robot.stamp_ns = stamp_ns
        return [(p.topic, message) for p in due for message in self._made(p, row)]

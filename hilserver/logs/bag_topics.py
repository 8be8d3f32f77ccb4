"""The topics of a bag that hilserver writes: every signal as float64, plus those of its flavour."""

import contextlib
import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from hilserver.logs.changes import TOPIC as CHANGES
from hilserver.logs.mcap_writer import TOPIC as FRAMES
from hilserver.logs.message import SCHEMA_NAME
from hilserver.logs.provenance import configuration_of, tag_ticks
from hilserver.ros import outgoing
from hilserver.ros.flavours import EXTRAS, FLAVOURS, Flavour, Published
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
_TAG: Final = EXTRAS["pose_stamped"]
_EDUART_FLAVOUR: Final = FLAVOURS["iotbot_shield"]
EDUART: Final[tuple[Published, ...]] = (
    TARGET,
    *_EDUART_FLAVOUR.published,
    _TAG,
)
"""As a recorder next to the real robot writes them: float32, 50 times a second."""


_MADE_UP: Final = {"iotbot/temperature": "shield.temperature_degc"}
"""Signals for which the live node has a substitute, and a bag has none."""


def _program(run: Mapping[str, Any]) -> tuple[Flavour, Shape]:
    """Return the robot program of a run, and the dimensions that its messages need."""
    # EduArt's messages hold no dimensions
    eduart = _EDUART_FLAVOUR, Shape(1.0, 1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    try:
        found = configuration_of(run)
        flavour = FLAVOURS[found["ros2"]["flavour"]]
        if flavour is _EDUART_FLAVOUR:
            return eduart
        shape = Shape.described(found["plant"], found["kinematics"])
    except (ValueError, KeyError, TypeError):  # of another version, or a foreign log
        return eduart
    return flavour, shape


class _Row(dict[str, float]):
    """The values of a frame; what was not measured is not there."""

    def __getitem__(self, name: str) -> float:
        value = super().__getitem__(name)
        if math.isnan(value):
            raise KeyError(name)
        return value


class RobotTopics:
    """Turns frames into the messages of a robot program, as far as the recorded signals allow.

    The configuration of the run says which program, by `ros2.flavour`; EduArt's if none is known.
    A message exists only where its data do, and no more often than its source measures: the shield
    sends everything at its own rate, but the tag comes from a node of its own.
    """

    def __init__(
        self,
        types: Types,
        names: list[str],
        run: Mapping[str, Any],
    ) -> None:
        # Foreign rows come at any time: with the longest period, each becomes a message.
        period_ns = 1_000_000_000 if run.get("foreign") else int(run["base_period_ns"])
        flavour, shape = _program(run)
        self._robot = RosFrame(types, shape, Odometer(shape))
        self._space = flavour.namespace
        self._names = names
        zeros = _Row(dict.fromkeys(names, 0.0))
        others = *flavour.published, _TAG
        asked = EDUART if flavour is _EDUART_FLAVOUR else others
        self.topics = [p for p in asked if self._made(p, zeros)]
        self.every = {
            published.topic: max(
                1, round((published.period_s or 1.0) * 1e9 / period_ns)
            )
            for published in self.topics
        }
        ticks = tag_ticks(run)
        if ticks is not None and _TAG.topic in self.every:
            self.every[_TAG.topic] = ticks
        self._latest: dict[str, int] = {}

    def absolute(self, topic: str) -> str:
        """Return a topic's name in a bag."""
        space = "" if topic.startswith("/") else f"/{self._space}/"
        return f"{space}{topic}".replace("//", "/")

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
        with contextlib.suppress(KeyError):
            self._robot.odometer.see(row)
        return [(p.topic, message) for p in due for message in self._made(p, row)]

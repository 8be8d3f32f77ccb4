"""Metrics that only ROS 2 has; the others are among those of peers, as peer ``ros2``."""

import time
from collections.abc import Collection, Iterator
from typing import Final

from hilserver.io.ros2.status import CommandState, Ros2Status
from hilserver.metrics import Metric, Row

Links = Collection[Ros2Status]  # one, or none if ROS 2 is not enabled


def _participants(links: Links) -> Iterator[Row]:
    for link in links:
        yield ("matched",), float(link.participants - link.strangers)
        yield ("strange",), float(link.strangers)


def _age(links: Links) -> Iterator[Row]:
    for link in links:
        age_s = link.command_age_s(time.monotonic_ns())
        if age_s is not None:
            yield (), age_s


METRICS: Final[tuple[Metric[Links], ...]] = (
    Metric(
        "hil_ros2_participants",
        "Other participants in the DDS domain; strange: no topic of theirs matches one of ours.",
        ("kind",),
        _participants,
    ),
    Metric(
        "hil_ros2_endpoints_apart",
        "Writers and readers of our topics that do not fit: other type, or type refused.",
        (),
        lambda links: [((), float(link.apart)) for link in links],
    ),
    Metric(
        "hil_ros2_command_held",
        "1 while a command stands only because its writer is alive (on_stale: hold).",
        (),
        lambda links: [
            ((), float(link.command is CommandState.HELD)) for link in links
        ],
    ),
    Metric(
        "hil_ros2_command_age_seconds",
        "Age of the newest accepted command of the ROS 2 host.",
        (),
        _age,
    ),
)

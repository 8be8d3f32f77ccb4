"""The controller's cycle: pose in, control law, set-points out, every 20 ms (absolute times)."""

import asyncio
import math
import os
import time
from dataclasses import dataclass, field
from datetime import UTC, datetime

import structlog

from hilserver.controller.nodes import SEQUENCE
from hilserver.controller.path import (
    STOP,
    Eight,
    Gains,
    Pose,
    Robot,
    follow,
    one_wheel_rpm,
)
from hilserver.controller.server import ControllerServer

PERIOD_S = 0.02
POSE_STALE_S = 0.5
PARENT_CHECK_CYCLES = 25

_log = structlog.get_logger(__name__)


@dataclass(slots=True)
class PoseWatch:
    """Distinguishes a pose that is updated from one that was written once."""

    stale_s: float = POSE_STALE_S
    _stamp: datetime | None = None
    _seen_s: float = -math.inf

    def observe(
        self,
        values: tuple[object, object, object],
        stamp: datetime | None,
        now_s: float,
    ) -> Pose | None:
        """Take the values of the nodes at `now_s` (monotonic).

        Return the pose; None if there is none or it is older than `stale_s`.
        """
        if stamp is not None and stamp != self._stamp:
            # The first stamp is the node's own initial value, not a pose.
            if self._stamp is not None:
                self._seen_s = now_s
            self._stamp = stamp
        numbers = [v for v in values if isinstance(v, int | float) and math.isfinite(v)]
        fresh = now_s - self._seen_s <= self.stale_s
        if fresh and len(numbers) == 3:
            return Pose(*map(float, numbers))
        return None


@dataclass(slots=True)
class FigureOfEight:
    """Drives a figure of eight over one server."""

    server: ControllerServer
    eight: Eight = field(default_factory=Eight)
    robot: Robot = field(default_factory=Robot)
    gains: Gains = field(default_factory=Gains)
    sequence: int = 0  # counts cycles, modulo 2**32
    # ``eight``: the figure. ``wheels``: each wheel alone, from the first pose on
    pattern: str = "eight"
    # read early: once the parent knows that we listen, it may end
    parent: int = field(default_factory=os.getppid)
    _s: float = 0.0
    _watch: PoseWatch = field(default_factory=PoseWatch)
    _driving: bool = False

    async def cycle(self) -> None:
        """Read the pose and serve one set of set-points; without a fresh pose the wheels stop."""
        x, stamp = self.server.read("pose_x")
        y = self.server.read("pose_y")[0]
        yaw = self.server.read("pose_yaw")[0]
        pose = self._watch.observe((x, y, yaw), stamp, time.monotonic())
        wheels = STOP
        if pose is not None and self.pattern == "wheels":
            wheels = one_wheel_rpm(self._s)
            self._s += PERIOD_S
        elif pose is not None:
            command = follow(
                self.eight, self.robot, self.gains, self._s, pose, PERIOD_S
            )
            self._s = command.s
            wheels = command.wheels_rpm
        if self._driving != (pose is not None):
            self._driving = pose is not None
            _log.info(
                "controller drives"
                if self._driving
                else "no fresh pose: wheels stopped"
            )
        self.sequence = (self.sequence + 1) % 2**32
        values: dict[str, object] = {
            f"rpm_set_{w.upper()}": rpm for w, rpm in wheels.items()
        }
        control = {"enable": True, SEQUENCE: self.sequence}
        await self.server.offer(values | control, datetime.now(UTC))

    async def run(self) -> None:
        """Cycle until cancelled, or until the process that started us is gone."""
        loop = asyncio.get_running_loop()
        deadline_s = loop.time()
        while self.sequence % PARENT_CHECK_CYCLES or os.getppid() == self.parent:
            await self.cycle()
            # A missed cycle is not repeated: the next one stays on the grid.
            missed = max(0, int((loop.time() - deadline_s) / PERIOD_S))
            deadline_s += (missed + 1) * PERIOD_S
            await asyncio.sleep(deadline_s - loop.time())
        _log.info("the parent process has ended")

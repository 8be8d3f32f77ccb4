"""Shadow mode: the simulation beside the real robot, whose values come in as ``measured.*``.

The gap between the two is always a metric; here a gap that lasts becomes an alarm, and the
simulated robot can be put where the real one is.
"""

import math
import time
from collections.abc import Callable, Mapping

from hilserver.config.monitoring import ShadowConfig
from hilserver.core.events import Event, EventBus, EventKind
from hilserver.image import Frame
from hilserver.plant.layout import Parameters
from hilserver.signals import MEASURED, SignalTable
from hilserver.status import GOOD

Pose = tuple[float, float, float]


class GapWatch:
    """Reports when a gap begins to exceed its limit and when that ends, once each."""

    def __init__(
        self,
        config: ShadowConfig,
        table: SignalTable,
        gaps: Callable[[], Mapping[str, float]],
        events: EventBus,
        *,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._config = config
        self._table = table
        self._gaps = gaps
        self._events = events
        self._now_ns = monotonic_ns
        self._since_ns: dict[str, int] = {}
        self._alarms: set[str] = set()

    @property
    def alarms(self) -> Mapping[str, bool]:
        """Whether each channel with a limit is in alarm."""
        return {channel: channel in self._alarms for channel in self._config.limits}

    def run(self) -> None:
        """Check the gaps; called by the supervise slice."""
        if not self._config.limits:
            return
        gaps = self._gaps()
        now_ns = self._now_ns()
        for channel, limit in self._config.limits.items():
            gap = gaps.get(channel)
            if gap is None or abs(gap) <= limit:
                self._since_ns.pop(channel, None)
                if channel in self._alarms:
                    self._alarms.remove(channel)
                    if gap is None:
                        how = "is no longer measured"
                    else:
                        how = "is within its limit again"
                    self._tell(200, channel, f"model gap: {channel} {how}")
            else:
                # It exceeds its limit: an alarm when it has done so for long enough.
                since_ns = self._since_ns.setdefault(channel, now_ns)
                if (
                    channel not in self._alarms
                    and now_ns - since_ns >= self._config.after_s * 1e9
                ):
                    self._alarms.add(channel)
                    unit = self._table[channel].unit
                    self._tell(
                        600,
                        channel,
                        f"model gap: {channel}: measured minus simulated is {gap:+.3g} {unit},"
                        f" limit {limit:g} {unit}",
                    )

    def _tell(self, severity: int, channel: str, text: str) -> None:
        self._events.publish(Event(EventKind.MODEL_GAP, severity, channel, text))


def measured_pose(
    newest: Callable[[str], float | None],
    table: SignalTable,
    frame: Frame | None,
    parameters: Parameters,
) -> Pose | None:
    """Return x [m], y [m] and yaw [rad] of the real centre of mass, None while not measured.

    ``measured.pose.*`` is used as it is; ``measured.nav.*`` is the pose of the tag: its place on
    the robot, and scale and frame of the navigation, are removed.

    Parameters
    ----------
    newest : callable
        Newest accepted value of a signal, None before the first.
    frame : Frame or None
        The newest one; its status codes show which values are stale.
    parameters : Parameters
        Of the plant, with the active terms.
    """
    if frame is None:
        return None
    pose, tag = (_fresh(group, newest, table, frame) for group in ("pose", "nav"))
    if pose is not None or tag is None:
        return pose
    yaw = math.remainder(tag[2] - parameters.nav_frame_yaw, math.tau)
    lever_x = parameters.lever_x
    lever_y = parameters.lever_y
    scale = parameters.nav_scale
    cos = math.cos(yaw)
    sin = math.sin(yaw)
    x_m = tag[0] / scale - lever_x * cos + lever_y * sin
    y_m = tag[1] / scale - lever_x * sin - lever_y * cos
    return x_m, y_m, yaw


def _fresh(
    group: str, newest: Callable[[str], float | None], table: SignalTable, frame: Frame
) -> Pose | None:
    names = [f"{MEASURED}{group}.{name}" for name in ("x_m", "y_m", "yaw_rad")]
    if any(frame.status[table.slot(name)] != GOOD for name in names):
        return None
    x, y, yaw = (newest(name) for name in names)
    if x is None or y is None or yaw is None:
        return None
    return (x, y, yaw)

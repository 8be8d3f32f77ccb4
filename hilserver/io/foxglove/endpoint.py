"""Serves viewers: signals in the form of recordings, transforms, the hall; takes set-points.

Values that a viewer publishes have the source ``page:foxglove``: they drive while ``page`` has
control, and the dead-man of the page ends those that are not renewed.
"""

import asyncio
import math
import time
from collections.abc import Mapping
from typing import Any, Final

import foxglove
import numpy as np
from foxglove import messages as fg
from foxglove.channels import FrameTransformChannel, SceneUpdateChannel
from foxglove.websocket import Capability
from pydantic import BaseModel, TypeAdapter

from hilserver.config.foxglove import FoxgloveConfig
from hilserver.core.leases import FOXGLOVE
from hilserver.errors import address_refused
from hilserver.image import Frame
from hilserver.io.arrival import WATCH_S, Arrivals
from hilserver.io.foxglove.door import ViewerDoor, hidden_host
from hilserver.io.foxglove.inbox import Inbox
from hilserver.io.foxglove.scene import scene
from hilserver.io.world import Part, World
from hilserver.logs.mcap_writer import TOPIC
from hilserver.logs.message import CDR_LITTLE_ENDIAN, SCHEMA_NAME, make_layout
from hilserver.ros.types import Types
from hilserver.tasks import SupervisedTask

SOURCE: Final = FOXGLOVE
TWIST, TWIST_TYPE = "/cmd_vel", "geometry_msgs/msg/Twist"
SET: Final = "/hilserver/set"
SCENE_EVERY_S: Final = 5.0
MOST_WAITING: Final = 100
TAKE_EVERY_S: Final = 0.005
# after a standstill, all that waited is in the inbox then
HANDED_OVER_NS: Final = 1_000_000_000
_SIGNALS: Final = TypeAdapter(dict[str, Any])


class _Vector(BaseModel):
    x: float = 0.0
    z: float = 0.0


class _Twist(BaseModel):
    """Message ``geometry_msgs/msg/Twist`` as JSON; pydantic refuses too deep nesting."""

    linear: _Vector = _Vector()
    angular: _Vector = _Vector()


class FoxgloveEndpoint(Part):
    """One WebSocket server, run by the SDK in threads of its own."""

    section = label = "foxglove"

    def __init__(self, config: FoxgloveConfig, world: World) -> None:
        self._config = config
        self._world = world
        signals = [signal for signal in world.table.scalars if not signal.hidden]
        slots = {signal.name: signal.slots[0] for signal in signals}
        layout = make_layout(list(slots))
        self._slots = np.array([slots[name] for name in layout.names], dtype=np.intp)
        self._row = np.zeros(1, dtype=layout.dtype)
        self._row["cdr"] = CDR_LITTLE_ENDIAN
        self._types = Types()
        self._context = foxglove.Context()
        schema = foxglove.Schema(
            name=SCHEMA_NAME, encoding="ros2msg", data=layout.schema.encode()
        )
        self._frames = foxglove.Channel(
            TOPIC, schema=schema, message_encoding="cdr", context=self._context
        )
        self._transforms = FrameTransformChannel("/transforms", context=self._context)
        self._scene = SceneUpdateChannel("/scene", context=self._context)
        self._door = ViewerDoor(config.origins, world.tasks)
        self._arrivals = Arrivals(
            round(world.config.page.deadman_ms * 1e6), HANDED_OVER_NS
        )
        # the frame shown last, when the hall is due again
        self._shown = -1
        self._scene_s = 0.0
        self._server: Any = None
        self._jobs: list[SupervisedTask] = []

    @property
    def url(self) -> str:
        """Where viewers connect."""
        port = self._door.port or self._config.port
        return f"ws://{self._config.host}:{port}"

    address = url

    async def start(self) -> None:
        """Listen; FailedError if the port is in use."""
        loop = asyncio.get_running_loop()

        def take_soon() -> None:
            loop.call_later(TAKE_EVERY_S, self._take_all, inbox)

        def wake() -> None:  # called in threads of the SDK
            if not loop.is_closed():
                loop.call_soon_threadsafe(take_soon)

        table = self._world.table

        def may_write(name: str) -> bool:
            return name in table and table[name].writable

        inbox = Inbox(self._understood, may_write, wake)
        host = hidden_host()
        try:
            self._server = await asyncio.to_thread(
                foxglove.start_server,
                name="hilserver",
                host=host,
                port=0,
                capabilities=[Capability.ClientPublish],
                supported_encodings=["json", "cdr"],
                server_listener=inbox,
                context=self._context,
                message_backlog_size=MOST_WAITING,
            )
            await self._door.open(
                self._config.host, self._config.port, (host, self._server.port)
            )
        except (RuntimeError, OSError, foxglove_error()) as error:
            await self.stop()
            why = error if isinstance(error, OSError) else OSError(str(error))
            where = f"{self._config.host} port {self._config.port}"
            raise address_refused(f"foxglove: cannot listen on {where}", why) from None
        tasks = self._world.tasks
        showing = tasks.every("foxglove", 1.0 / self._config.rate_hz, self._show_newest)
        watching = tasks.every("foxglove: watch", WATCH_S, self._look)
        self._jobs = [showing, watching]

    async def stop(self) -> None:
        """Close all connections."""
        for job in self._jobs:
            await job.end()
        await self._door.close()
        if self._server is not None:
            await asyncio.to_thread(self._server.stop)
        self._server = None
        self._jobs = []

    def _look(self) -> None:
        self._arrivals.look(time.monotonic_ns())

    def _show_newest(self) -> None:
        frame = self._world.image.latest()
        now_s = time.monotonic()
        if frame is not None and frame.number != self._shown:
            self._shown = frame.number
            stamp_ns = self._world.clock.utc_ns(frame.planned_ns)
            if self._frames.has_sinks():
                row = self._row
                row["number"] = frame.number
                row["tick"] = frame.tick
                row["planned_ns"] = frame.planned_ns
                row["values"] = frame.values[self._slots]
                row["status"] = frame.status[self._slots]
                self._frames.log(row.tobytes(), log_time=stamp_ns)
            if self._transforms.has_sinks():
                for parent, child, name in (
                    ("map", "base_link", "pose"),
                    ("map", "nav", "nav"),
                ):
                    self._transforms.log(
                        self._transform(frame, parent, child, name, stamp_ns),
                        log_time=stamp_ns,
                    )
        if self._scene.has_sinks() and now_s >= self._scene_s:
            self._scene_s = now_s + SCENE_EVERY_S
            self._scene.log(scene(self._world.hall, self._world.shape))

    def _transform(
        self, frame: Frame, parent: str, child: str, name: str, stamp_ns: int
    ) -> Any:
        slot = self._world.table.slot
        values = frame.values
        x, y, yaw = (
            float(values[slot(f"{name}.{part}")]) for part in ("x_m", "y_m", "yaw_rad")
        )
        sec, nsec = divmod(stamp_ns, 10**9)
        timestamp = fg.Timestamp(sec=sec, nsec=nsec)
        translation = fg.Vector3(x=x, y=y, z=0.0)
        rotation = fg.Quaternion(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))
        return fg.FrameTransform(
            timestamp=timestamp,
            parent_frame_id=parent,
            child_frame_id=child,
            translation=translation,
            rotation=rotation,
        )

    # --- what viewers publish ---------------------------------------------------------------------

    def _take_all(self, inbox: Inbox) -> None:
        messages, received_ns = inbox.take()
        if not messages:
            return
        came_ns = self._arrivals.came_ns(received_ns)
        for values in messages:
            self._world.gate.write(
                SOURCE, values, received_ns=received_ns, commanded_ns=came_ns
            )

    def _understood(
        self, topic: str, encoding: str, data: bytes
    ) -> Mapping[str, object]:
        if topic == SET and encoding == "json":
            return _SIGNALS.validate_json(data)
        if topic != TWIST:
            raise ValueError(f"publish {TWIST} ({TWIST_TYPE}) or {SET} (JSON)")
        if encoding == "json":
            twist: Any = _Twist.model_validate_json(data)
        else:
            twist = self._types.decode(data, TWIST_TYPE)
        return {
            "control.mode": 1,
            "twist.linear_m_s": twist.linear.x,
            "twist.angular_rad_s": twist.angular.z,
        }


def foxglove_error() -> type[Exception]:
    """Return the SDK's error class, whose place differs between versions."""
    found = getattr(foxglove, "FoxgloveError", RuntimeError)
    if isinstance(found, type) and issubclass(found, Exception):
        return found
    return RuntimeError

"""Runs the shield: the thread of the line, the requests it hands over, the host's silence."""

import asyncio
import atexit
import contextlib
import dataclasses
import math
import os
import threading
import time
from collections.abc import Iterator

import numpy as np
import structlog

from hilserver.config.shield import ShieldConfig
from hilserver.core.events import Event, EventKind
from hilserver.core.staleness import Transition
from hilserver.errors import FailedError
from hilserver.image import Row
from hilserver.io.arrival import WATCH_S
from hilserver.io.link_status import LinkState
from hilserver.io.shield import words as w
from hilserver.io.shield.device import Device, ShieldFault
from hilserver.io.shield.line import SerialLine, open_device, open_pseudo_terminal
from hilserver.io.shield.protocol import BYTE_NS, REQUEST_BYTES, RESPONSE_BYTES, Request
from hilserver.io.shield.status import NAME, ShieldStatus
from hilserver.io.source import Source
from hilserver.io.world import Part, World
from hilserver.scheduler.realtime import (
    AuditFinding,
    RealtimeSettings,
    request_for_this_thread,
)

# silence that ends a burst: 23 bytes; hosts keep 8 ms between requests
PAUSE_NS = 2_000_000
REOPEN_S = 0.5
END_WITHIN_S = 5.0

_log = structlog.get_logger(__name__)


class HostGains:
    """Applies the gains that a host sets to the plant's controller."""

    def __init__(self, world: World) -> None:
        self._gate = world.gate
        self._image = world.image
        self._table = world.table
        self._loop = world.robot.loop
        self._period_s = world.robot.period_s

    def apply(self, k_p: float, k_i: float) -> None:
        """Latch gains [%/rpm], [%/(rpm s)] at the next tick; NaN: as configured.

        ValueError if another source has control, or the loop would not be stable.
        """
        if self._gate.owner != NAME:
            raise ValueError(f"gains are not applied: '{self._gate.owner}' has control")
        k_p = self._loop.k_p if math.isnan(k_p) else k_p
        k_i = self._loop.k_i if math.isnan(k_i) else k_i
        loop = dataclasses.replace(self._loop, k_p=k_p, k_i=k_i)
        if k_p < 0.0 or k_i < 0.0 or not loop.is_stable(self._period_s):
            raise ValueError(
                f"gains are not applied: kp {k_p:g}, ki {k_i:g} are not stable"
            )
        values = {"internal.gains": 1.0, "internal.k_p": k_p, "internal.k_i": k_i}
        self._image.push(
            [Row(self._table.slot(name), value) for name, value in values.items()]
        )


class ShieldLink(Part):
    """Answers a host as the shield does."""

    section = label = NAME
    status: ShieldStatus  # always up to date

    def __init__(self, config: ShieldConfig, world: World) -> None:
        # compiled only if there is a shield
        from hilserver.io.shield.answer import places  # noqa: PLC0415
        from hilserver.io.shield.wire import Memory, serve  # noqa: PLC0415

        self._serve = serve
        self._memory = Memory
        self.status = status = ShieldStatus(NAME)
        self._source = Source(
            config.driver,
            "shield",
            status,
            world.gate,
            world.events.publish,
            fresh=lambda: f"shield: a host is sending on {self.address}",
            kinds=ShieldFault,
            is_exact=True,  # the thread of the line stamps arrivals
        )
        max_rpm = world.table["wheel.fl.setpoint_rpm"].high
        gains = HostGains(world)
        self.device = Device(
            config, status, self._source, max_rpm=max_rpm, apply=gains.apply
        )
        self.grants: list[
            AuditFinding
        ] = []  # what the system granted to the thread of the line
        self._config = config
        self._world = world
        self._image = world.image
        mechatronic = world.config.mechatronic
        body = mechatronic.enabled and mechatronic.sensors == "body"
        self._slots = np.array(
            places(world.table, config.wheels, body=body), dtype=np.int64
        )
        self._received_ns: int | None = None
        self._seen: dict[ShieldFault, int] = {}
        self._thread = threading.Thread(target=self._run, name="shield", daemon=True)
        self._stopping = threading.Event()
        self._line: SerialLine | None = None
        words = status.words
        words[w.CRC] = config.variant == "crc"
        words[w.RAW] = 1
        words[w.BYTE] = BYTE_NS if config.pace else 0
        words[w.DELAY] = round(config.reply_delay_ms * 1e6)
        words[w.PAUSE] = PAUSE_NS
        words[w.IS_PTY] = config.device is None
        words[w.LIMIT] = self.device.limit_ns

    @property
    def thread_id(self) -> int:
        """Thread id of the line's thread in the operating system."""
        return self._thread.native_id or 0

    @property
    def address(self) -> str:
        """The path that a host opens."""
        line = self._line
        if line is None:
            return ""
        return str(line.link or line.path)

    async def start(self) -> None:
        """Open the line and answer on it; FailedError if the line cannot be opened."""
        self._loop = asyncio.get_running_loop()
        self._line = self._opened()
        self.status.endpoint = self.address
        self.status.state = LinkState.CONNECTING
        self._doorbell = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._loop.add_reader(self._doorbell, self._answer_doorbell)
        self._watching = self._world.tasks.every("shield: watch", WATCH_S, self._look)
        self.device.disable()
        self._thread.start()
        atexit.register(self._end_thread)

    async def stop(self) -> None:
        """Close the line; limited to `END_WITHIN_S`."""
        if self._thread.ident is None:
            return
        self._watching.cancel()
        await asyncio.to_thread(self._end_thread)
        atexit.unregister(self._end_thread)
        self._loop.remove_reader(self._doorbell)
        os.close(self._doorbell)
        if self._line is not None:  # None if it was lost
            self._line.close()
        self.status.connected = False
        self.status.state = LinkState.STOPPED

    def _opened(self) -> SerialLine:
        if self._config.device is not None:
            return open_device(self._config.device)
        return open_pseudo_terminal(self._world.folder / self._config.link)

    @property
    def _realtime(self) -> RealtimeSettings:
        """What the thread asks for: less than the plant's, and never its core.

        Without the line's pace a host could keep it busy for ever, so it then has no priority.
        """
        if self._config.pace:
            priority = self._world.config.scheduler.realtime.priority - 1
        else:
            priority = 0
        return RealtimeSettings(priority=max(priority, 0))

    def _end_thread(self) -> None:
        """End the thread before the interpreter frees the arrays under it."""
        self._stopping.set()
        self.status.words[w.STOP] = 1
        self._thread.join(END_WITHIN_S)

    # --- the thread of the line -------------------------------------------------------------------

    def _run(self) -> None:
        self.grants = request_for_this_thread(self._realtime)
        image = self._image
        n = self._image.n_slots
        memory = self._memory(
            self.status.words,
            self._slots,
            chunk=np.zeros(REQUEST_BYTES, dtype=np.uint8),
            request=np.zeros(REQUEST_BYTES, dtype=np.uint8),
            out=np.zeros(max(RESPONSE_BYTES.values()), dtype=np.uint8),
            values=image.values,
            words=image.words,
            frame=np.empty(n),
            info=np.empty(n + 3, dtype=np.int64),
            scratch=np.zeros(3, dtype=np.int64),
            poll=np.zeros(2, dtype=np.int32),
        )
        line = self._line
        while line is not None and not self._stopping.is_set():
            if not self._serve(line.file, self._doorbell, memory):
                return
            line = self._reopen(line)

    def _reopen(self, line: SerialLine) -> SerialLine | None:
        """Wait until a lost device is back."""
        self._line = None
        line.close()
        text = f"shield: the line {line.path} is lost"
        event = Event(EventKind.PEER_LOST, 800, self.status.name, text)
        with contextlib.suppress(RuntimeError):  # the event loop is closed
            self._loop.call_soon_threadsafe(self._world.events.publish, event)
        # of that line alone
        self.status.words[[w.FILL, w.RX_LAST, w.EMPTY, w.MORE]] = 0
        while not self._stopping.wait(REOPEN_S):
            with contextlib.suppress(FailedError):
                self._line = self._opened()
                return self._line
        return None

    # --- the event loop ---------------------------------------------------------------------------

    def _answer_doorbell(self) -> None:
        with contextlib.suppress(BlockingIOError):
            os.eventfd_read(self._doorbell)
        self._take_requests()

    def _take_requests(self) -> None:
        words = self.status.words
        is_new = words[w.RING_TAIL] < words[w.RING_HEAD]
        if is_new:
            self._world.gate.leases.limit(NAME, self.device.limit_ns * 1e-6)
        while words[w.RING_TAIL] < words[w.RING_HEAD]:
            number = int(words[w.RING_TAIL]) & (w.WAITING_MOST - 1)
            row = w.RING_ROWS + 4 * number
            command, flags, payload, received_ns = words[row : row + 4].tolist()
            words[w.RING_TAIL] += 1
            if self._received_ns is not None:
                self.status.interval.observe(max(received_ns - self._received_ns, 0))
            self._received_ns = received_ns
            terminated = not flags & w.ALONE
            data = payload.to_bytes(8, "little", signed=True)
            self._source.staleness.renew(received_ns)
            self.device.take(Request(command, data, received_ns, terminated))
        if is_new:
            self._world.gate.renew(NAME, received_ns)

    def _look(self) -> None:
        # requests that waited while the event loop stood are not silence
        self._take_requests()
        status = self.status
        now_ns = time.monotonic_ns()
        status.connected = bool(status.words[w.CONNECTED]) and self._line is not None
        status.state = LinkState.CONNECTED if status.connected else LinkState.CONNECTING
        # What the thread has counted since the last look.
        for kind, word, text in (
            (
                ShieldFault.SKIPPED_BYTES,
                w.SKIPPED,
                "bytes that are not part of a request",
            ),
            (
                ShieldFault.UNANSWERED,
                w.UNANSWERED,
                "requests come too fast for the line to answer",
            ),
            (
                ShieldFault.UNHEARD,
                w.UNHEARD,
                "requests came too fast to be carried out",
            ),
        ):
            count = self.status.count(word)
            if count > self._seen.get(kind, 0):
                self._seen[kind] = count
                self._source.faults.report(kind, "line", text, now_ns)
        self._source.staleness.limit_ns = status.words[w.LIMIT] = self.device.limit_ns
        if self._source.watch(now_ns) is Transition.LOST:
            status.enabled = False


def parts(world: World) -> Iterator[ShieldLink]:
    """Yield the shield, if the configuration has one."""
    if world.config.shield.enabled:
        yield ShieldLink(world.config.shield, world)

"""What `hilserver run` says beside its log: where it is reached, and how it is doing.

People get lines of text and, on a terminal, a line of status that stays below the log. Where the
log is JSON, the same is one JSON line, so that every line can be parsed.
"""

import asyncio
import contextlib
import math
import sys
from collections.abc import AsyncIterator

from hilserver.daemon.daemon import Daemon
from hilserver.monitoring.logging_setup import notice
from hilserver.program.footer import Footer

STATUS_EVERY_S = 2.0


class Announcer:
    """Says things to people or to programs.

    Parameters
    ----------
    readable : bool
        Lines are for people.
    footer : Footer or None
        Where the status stands; None: nowhere.
    """

    def __init__(self, *, readable: bool, footer: Footer | None) -> None:
        self._readable, self._footer = readable, footer
        self._page_url = ""

    def page(self, url: str) -> None:
        """Say where the operator page is."""
        self._page_url = url
        self._say(f"operator page: {url}", "operator page", url=url)

    def running(self, daemon: Daemon) -> None:
        """Say that the robot runs, and where everything is."""
        places = {
            "opcua": ("OPC UA", daemon.server and daemon.server.url),
            "metrics": ("metrics", daemon.http and daemon.http.url),
            "shield": ("shield", daemon.shield and daemon.shield.address),
            "foxglove": ("foxglove", daemon.foxglove and daemon.foxglove.url),
            "ros2": ("ROS 2", daemon.ros2 and daemon.ros2.address),
        }
        peers = {peer.config.name: peer.config.endpoint for peer in daemon.peers}
        lines = ["hilserver is running; stop it with Ctrl-C"]
        lines += [f"  {word:8} {where}" for word, where in places.values() if where]
        lines += [f"  peer     {name} at {endpoint}" for name, endpoint in peers.items()]
        where = {key: place for key, (_, place) in places.items()}
        self._say("\n".join(lines), "hilserver is running", **where, peers=peers)

    def _say(self, text: str, event: str, **details: object) -> None:
        if self._readable:
            print(text, file=self._footer or sys.stderr, flush=True)
        else:
            notice(event, **details)

    @contextlib.asynccontextmanager
    async def showing_status(self, daemon: Daemon) -> AsyncIterator[None]:
        """Keep the line of status up to date while the context lasts."""
        if self._footer is None:
            yield
            return
        task = asyncio.create_task(self._show_status(daemon, self._footer), name="status line")
        try:
            yield
        finally:
            task.cancel()
            self._footer.show("")

    async def _show_status(self, daemon: Daemon, footer: Footer) -> None:
        while True:
            footer.show(status_line(daemon, self._page_url))
            await asyncio.sleep(STATUS_EVERY_S)


def status_line(daemon: Daemon, page_url: str) -> str:
    """Return state, pose, who drives, real-time factor, worst margin and the page's address."""
    parts = [daemon.control.state.word]
    with contextlib.suppress(LookupError):
        x_m, y_m, yaw_rad = (_value(daemon, f"pose.{name}") for name in ("x_m", "y_m", "yaw_rad"))
        parts.append(f"x {x_m:.2f} m, y {y_m:.2f} m, yaw {math.degrees(yaw_rad):.0f}°")
    parts.append(f"{daemon.gate.owner} drives")
    statistics = daemon.scheduler.statistics
    if math.isfinite(factor := statistics.tick.real_time_factor):
        parts.append(f"{factor:.2f} x real time")
    paced = [statistics.slice(part.name) for part in daemon.assembly.slices if part.compiled]
    margins_ns = [s.margin_min_ns for s in paced if s.margin_min_ns is not None]
    if margins_ns:
        parts.append(f"worst margin {min(margins_ns) * 1e-6:.2f} ms")
    if page_url:
        parts.append(page_url)
    return " | ".join(parts)


def _value(daemon: Daemon, name: str) -> float:
    value = daemon.outputs.read(name)[0]
    assert isinstance(value, float)
    return value

"""What `hilserver run` prints in addition to its log: where to reach it, and how it is doing.

People get lines of text and, on a terminal, a status line that stays below the log. If the log is
JSON, each announcement is one JSON line, so that every line can be parsed.
"""

import contextlib
import json
import math
import threading
import time
from collections.abc import AsyncIterator, Iterator, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Self

from hilserver import __version__
from hilserver.commands.compile_progress import CompileProgress
from hilserver.program.writer import Footer, Writer

if (
    TYPE_CHECKING
):  # importing it takes seconds, and the first line must not wait for that
    from hilserver.daemon.daemon import Daemon

STATUS_EVERY_S = 2.0
# after so long it is said what a start waits for, then ever more rarely
LONG_START_S = 20.0
HELD_UP_SHARE = 0.5  # of a core: a start that has had less waits for the processor
_NOWHERE: dict[str, object] = dict.fromkeys(
    ("opcua", "metrics", "shield", "foxglove", "ros2")
)


class Announcer:
    """Makes announcements to people or to programs.

    A context manager; at its end the status line is removed.
    """

    def __init__(self, writer: Writer, line_format: str) -> None:
        self._writer = writer
        self._footer = Footer(writer) if writer.isatty() else None
        self.out = self._footer or writer  # where log lines go, too
        self._is_readable = line_format == "console" or (
            line_format != "json" and writer.isatty()
        )
        writer.lost_line = lambda lost: self._line(
            f"{lost} lines were lost: nothing read them", {}
        )
        self.page_url = ""
        self._progress: CompileProgress | None = None
        self.waits_for = "its libraries"  # what a start does now, for whoever wonders
        self._has_started = threading.Event()

    def say(self, text: str, event: str = "", **details: object) -> None:
        """Say `text` to people, or `event` (by default the text) and `details` to programs."""
        line = text if self._is_readable else self._line(event or text, details)
        self.out.write(f"{line}\n")

    def last_words(self, text: str) -> None:
        """Say why the process is ended now, and wait a moment until it is written."""
        self.say(f"hilserver {text}")
        self._writer.drain()

    def _line(self, event: str, details: dict[str, object]) -> str:
        if self._is_readable:
            return f"hilserver: {event}"
        stamp = datetime.now(UTC).isoformat().replace("+00:00", "Z")
        return json.dumps(
            {"level": "info", **details, "event": event, "timestamp": stamp}
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._footer is not None:
            self._footer.show("")

    @contextlib.contextmanager
    def patient(self) -> Iterator[None]:
        """Say what a long start waits for, from a thread, until it runs or the context ends."""
        self._has_started.clear()
        began_s = time.monotonic()

        def tell() -> None:
            pause_s = LONG_START_S
            while not self._has_started.wait(pause_s):
                pause_s *= 2
                self.still_starting(time.monotonic() - began_s, time.process_time())

        threading.Thread(target=tell, name="patience", daemon=True).start()
        try:
            yield
        finally:
            self._has_started.set()

    def still_starting(self, seconds: float, processor_s: float) -> None:
        """Say what a start waits for that has lasted so long, with so much time of a processor."""
        share = processor_s / seconds
        why = f"waits for {self.waits_for}"
        if share < HELD_UP_SHARE and self._progress is None:
            why += f"; a quota or other programs have left it {share:.0%} of a core"
        text = f"hilserver is still starting after {seconds:.0f} s: it {why}"
        self.say(text, "still starting", seconds=round(seconds), why=why)

    def starting(self) -> None:
        """Say that it is starting, if anyone may be reading."""
        if self._writer.is_watched:
            self.say(
                f"hilserver is starting, version {__version__}; stop it with Ctrl-C"
            )

    def compiling(self, functions: Sequence[str]) -> None:
        """Say that these functions are being compiled; none: still the last ones."""
        if not self._writer.is_watched:
            return
        if self._progress is None:
            self._progress = CompileProgress.begun()
            text = f"hilserver is compiling the model for this computer: {self._progress.estimate}"
            self.say(f"{text}; the next start finds it compiled")
        self._progress.add(len(functions))
        if self._footer is not None:
            self._footer.show(self._progress.line)

    def _say_compiled(self) -> None:
        """Say how long compiling took, if anything was compiled."""
        if self._progress is not None:
            self.say(f"hilserver has compiled {self._progress.ended()}")

    def warn(self, text: str) -> None:
        """Say what is not as it should be."""
        self.say(f"hilserver: {text}", text, level="warning")

    def page(self, url: str, moved: str) -> None:
        """Say where the operator page is, and why it `moved` from its port, if it did."""
        self.page_url = url
        if moved:
            self.say(
                f"operator page: {url} ({moved})", "operator page", url=url, why=moved
            )
        else:
            self.say(f"operator page: {url}", "operator page", url=url)

    def running(self, daemon: "Daemon") -> None:
        """Say that the robot runs, and where everything is."""
        from hilserver.daemon.doors import table_of_doors  # noqa: PLC0415 - as above

        self._has_started.set()
        self._say_compiled()
        peers = {
            part.label: part.address for part in daemon.parts if part.section == "peers"
        }
        others = {
            part.section: part for part in daemon.parts if part.section != "peers"
        }
        lines = ["hilserver is running; stop it with Ctrl-C"]
        lines += [f"  {part.label:8} {part.address}" for part in others.values()]
        lines += [
            f"  peer     {name} at {endpoint}" for name, endpoint in peers.items()
        ]
        lines.append(f"  {daemon.config.after_reset}")
        lines += ["  doors, and who may do what besides watching:"]
        lines += [f"  {line}" for line in table_of_doors(daemon.config)]
        where = {section: part.address for section, part in others.items()}
        self.say(
            "\n".join(lines), "hilserver is running", **_NOWHERE | where, peers=peers
        )

    @contextlib.asynccontextmanager
    async def showing_status(self, daemon: "Daemon") -> AsyncIterator[None]:
        """Keep the status line up to date while the context lasts."""
        if self._footer is None:
            yield
            return
        footer = self._footer

        def show() -> None:
            footer.show(status_line(daemon, self.page_url))

        job = daemon.core.tasks.every("status line", STATUS_EVERY_S, show)
        try:
            yield
        finally:
            job.cancel()


def status_line(daemon: "Daemon", page_url: str) -> str:
    """Return state, pose, who drives, real-time factor, worst margin and the page's address."""
    is_waiting = daemon.gate.interlock.waits
    parts = [daemon.control.state.word + ", waits for Start" * is_waiting]
    with contextlib.suppress(LookupError):
        x_m, y_m, yaw_rad = (
            _value(daemon, f"pose.{name}") for name in ("x_m", "y_m", "yaw_rad")
        )
        parts.append(f"x {x_m:.2f} m, y {y_m:.2f} m, yaw {math.degrees(yaw_rad):.0f}°")
    parts.append(f"{daemon.gate.owner} drives")
    statistics = daemon.scheduler.statistics
    if math.isfinite(factor := statistics.tick.real_time_factor):
        parts.append(f"{factor:.2f} x real time")
    paced = [
        statistics.slice(part.name) for part in daemon.assembly.slices if part.compiled
    ]
    margins_ns = [s.margin_min_ns for s in paced if s.margin_min_ns is not None]
    if margins_ns:
        parts.append(f"worst margin {min(margins_ns) * 1e-6:.2f} ms")
    if page_url:
        parts.append(page_url)
    return " | ".join(parts)


def _value(daemon: "Daemon", name: str) -> float:
    value = daemon.outputs.read(name)[0]
    assert isinstance(value, float)
    return value

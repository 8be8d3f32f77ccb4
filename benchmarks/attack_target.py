"""The target of the attack: a daemon and its healthy client, separate processes on loopback."""

import asyncio
import contextlib
import json
import math
import os
import re
import subprocess
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from benchmarks.target import running_daemon
from hilserver.errors import FailedError
from hilserver.image import ImageReader
from hilserver.program.children import piped, python
from hilserver.scheduler import Statistics

_LOOK_BACK, _EVERY = 1500, 2
"""Frames: fewer than the ring keeps; every second one gives ages to 2 ms."""
_SAFE = 3
_CONTROL = {
    "scheduler": {
        "base_period_ms": 10,
        "slices": {"plant": 10, "sensors": 10, "publish": 20, "supervise": 100},
        "realtime": {"priority": 0, "lock_memory": False, "hold_latency_target": False},
    }
}
"""The second daemon serves the same nodes at the same rate, and competes with no plant."""


class PeerWatch:
    """Reads from the process image how old the peer's set-points were, tick by tick.

    Attributes
    ----------
    safe_ticks : int
        Sampled ticks in the safe state.
    """

    def __init__(self, image: ImageReader) -> None:
        self._image = image
        slots = {row["name"]: row["slots"][0] for row in image.description["signals"]}
        self._sequence, self._state = slots["input.sequence"], slots["sim.state"]
        self._number, self._changed_ns, self._last = image.head, 0, math.nan
        self.safe_ticks = 0

    def ages_ms(self) -> list[float]:
        """Return the age of the newest set-points in each tick since the last call [ms]."""
        ages: list[float] = []
        head = self._image.head
        for number in range(max(self._number, head - _LOOK_BACK), head, _EVERY):
            frame = self._image.frame(number)
            if frame is None:
                continue
            if frame.values[self._sequence] != self._last:
                self._last, self._changed_ns = (
                    frame.values[self._sequence],
                    frame.planned_ns,
                )
            ages.append((frame.planned_ns - self._changed_ns) / 1e6)
            self.safe_ticks += int(frame.values[self._state] == _SAFE)
        self._number = head
        return ages


@dataclass
class Target:
    """The daemon and the healthy client."""

    url: str
    daemon: "subprocess.Popen[str]"
    probe: "subprocess.Popen[str]"
    statistics: Statistics
    peer: PeerWatch

    @property
    def missed_ticks(self) -> int:
        """Skipped ticks of the plant."""
        return self.statistics.tick.missed_ticks

    @property
    def memory_mb(self) -> float:
        """Resident memory of the daemon."""
        status = Path(f"/proc/{self.daemon.pid}/status").read_text(encoding="ascii")
        found = re.search(r"VmRSS:\s+(\d+)", status)
        return int(found[1]) / 1024 if found else 0.0

    @property
    def pacing_priority(self) -> int:
        """SCHED_FIFO priority that the pacing thread was granted; 0: none."""
        tasks = Path(f"/proc/{self.daemon.pid}/task").iterdir()
        return max(os.sched_getparam(int(task.name)).sched_priority for task in tasks)

    def reads_ms(self) -> list[float]:
        """Return the latencies of the healthy client's reads since the last call."""
        stdin, stdout = _pipes(self.probe)
        try:
            stdin.write("\n")
            stdin.flush()
            line = stdout.readline()
        except OSError:
            line = ""
        if not line:
            raise FailedError("the healthy client lost its connection")
        return [float(value) for value in json.loads(line)]

    def check(self) -> None:
        """Raise FailedError if the daemon is gone."""
        if self.daemon.poll() is not None:
            raise FailedError(
                f"the daemon ended with code {self.daemon.returncode}: a crash"
            )


def _pipes(process: "subprocess.Popen[str]") -> tuple[IO[str], IO[str]]:
    assert process.stdin is not None
    assert process.stdout is not None
    return process.stdin, process.stdout


@contextlib.asynccontextmanager
async def running_target(cpu: int | None) -> AsyncIterator[Target]:
    """Start a daemon and a healthy client; only the pacing thread may use `cpu`."""
    # With policy `skip` every late tick is one missed tick.
    settings = {"scheduler": {"policy": "skip", "realtime": {"cpu": cpu}}}
    image = f"bench-attack-{os.getpid()}"
    async with running_daemon(settings, image, "--demo") as (url, daemon):
        with piped(
            python("-m", "benchmarks.attack_probe", url), name="the probe"
        ) as probe:
            reader = ImageReader.attach(image)
            _, words = reader.region("statistics")
            subject = Target(
                url, daemon, probe, Statistics.attach(words), PeerWatch(reader)
            )
            await asyncio.sleep(1.0)
            subject.reads_ms()
            yield subject


@contextlib.asynccontextmanager
async def running_control() -> AsyncIterator[str]:
    """Start a second daemon that takes the same load instead of the first; give its address."""
    async with running_daemon(_CONTROL, f"bench-control-{os.getpid()}") as (url, _):
        yield url


def core_for_the_plant() -> int | None:
    """Reserve one core for the plant and return its number; None if there is only one.

    Attacker and clients represent other computers: neither their load nor their system calls, which
    an ordinary kernel does not interrupt, must affect the daemon.
    """
    cores = os.sched_getaffinity(0)
    if len(cores) < 2:
        return None
    cpu = max(cores)
    os.sched_setaffinity(0, cores - {cpu})
    return cpu

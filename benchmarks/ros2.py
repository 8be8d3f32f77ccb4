"""ROS 2 over DDS: rate, latency, losses and cost, next to two other DDS programs in the same run.

A daemon publishes everything in the flavour `iotbot_shield` to a Fast DDS program and takes its
commands, 50 a second. At the same time a Cyclone DDS program in C writes a RELIABLE and a
BEST_EFFORT topic at the same rate to the same reader, and reads the same commands: the losses and
latency of two programs without hilserver. Latency is from the time stamp that DDS gives a sample
when it is written to its arrival in the reader's callback; losses are gaps in its writer's
sequence. Cost is the daemon's processor time, compared with that of a daemon without ROS 2.
"""

import argparse
import asyncio
import os
import tempfile
import time
from collections.abc import Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.ros2_peers import (
    Endpoint,
    arguments,
    build_cyclone,
    build_fast_dds,
    published,
)
from hilserver.bench.report import Result
from hilserver.compiled.histogram import Histogram125
from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.errors import FailedError
from hilserver.monitoring.logging_setup import setup_logging
from hilserver.program import event_loop
from hilserver.ros.flavours import RPM, TWIST
from hilserver.ros.types import known_types

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

RATE_HZ: Final = 50
PERIOD_US: Final = 1_000_000 // RATE_HZ
EXTRAS: Final = {"tf": True, "clock": True, "odom": True, "pose_stamped": True}
COMMANDS: Final = "rt/iotbot/rpm"
REFERENCES: Final = ("reliable", "best_effort")
READY: Final = b"ready\n"
START_WITHIN_S: Final = 60.0
SETTLE_S: Final = 1.0
Times = NDArray[np.float64]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``--seconds`` and ``--domain``."""
    parser.add_argument("--seconds", type=int, default=60, help="how long (default 60)")
    parser.add_argument(
        "--domain", type=int, default=101, help="DDS domain (default 101)"
    )


class Commands(Histogram125):
    """Keeps the latency of every command."""

    def __init__(self) -> None:
        super().__init__()
        self.all_us: list[float] = []

    def observe(self, value_ns: int) -> None:
        """Keep one latency."""
        super().observe(value_ns)
        self.all_us.append(value_ns * 1e-3)


@dataclass
class Stream:
    """Samples of one topic in a reader: latency [us] and sequence number of the writer."""

    late_us: list[float] = field(default_factory=list)
    sequence: list[int] = field(default_factory=list)

    @property
    def lost(self) -> int:
        """Number of missing samples between the first and the last."""
        return max(self.sequence) - min(self.sequence) + 1 - len(set(self.sequence))


class Peer:
    """A program of another DDS implementation; what it reads goes to a file."""

    def __init__(self, program: Path, domain: int, *endpoints: Endpoint) -> None:
        self._command = [str(program), *arguments(domain, endpoints)]
        self._topics = [topic for _, topic, _, _ in endpoints]
        self._file: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 -- lives as long as this
        self._process: asyncio.subprocess.Process | None = None

    async def start(self) -> None:
        """Start it; return when its writers have found readers."""
        self._process = await asyncio.create_subprocess_exec(
            *self._command, stdin=asyncio.subprocess.PIPE, stdout=self._file
        )
        deadline_s = time.monotonic() + START_WITHIN_S
        # The child shares the position in the file: read without moving it.
        while os.pread(self._file.fileno(), len(READY), 0) != READY:
            if self._process.returncode is not None or time.monotonic() > deadline_s:
                raise FailedError(
                    f"{self._command[0]} finds no other program in its DDS domain"
                )
            await asyncio.sleep(0.05)

    def write(self, cdr: bytes, times: int) -> None:
        """Write a sample to the first endpoint, `times` times at `RATE_HZ`."""
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.write(f"0 {cdr.hex()} {times} {PERIOD_US}\n".encode())

    async def end(self) -> None:
        """End it when it has written everything."""
        process = self._process
        if process is None or process.stdin is None:
            return
        process.stdin.close()
        try:
            await asyncio.wait_for(process.wait(), START_WITHIN_S)
        except TimeoutError:
            process.kill()
            await process.wait()

    def streams(self) -> dict[str, Stream]:
        """Return the samples that it read, by topic."""
        found = {topic: Stream() for topic in self._topics}
        self._file.seek(0)
        for line in self._file:
            words = line.split()
            if len(words) == 4:
                stream = found[self._topics[int(words[0])]]
                stream.late_us.append(int(words[1]) * 1e-3)
                stream.sequence.append(int(words[2]))
        self._file.close()
        return found


@dataclass
class Seen:
    """Results of one run."""

    ours: dict[str, Stream]
    theirs: dict[str, Stream]
    commands_us: Sequence[float]
    reference_commands_us: Sequence[float]
    written: int
    rate_hz: float
    cpu_share: float
    real_time_factor: float


def run(args: argparse.Namespace) -> list[Result]:
    """Measure."""
    setup_logging("ERROR")
    with tempfile.TemporaryDirectory() as folder:
        fast_dds = build_fast_dds(Path(folder))
        cyclone = build_cyclone(Path(folder), [RPM, TWIST])
        seen = event_loop.run(_measure(args, fast_dds, cyclone))
        idle_share = event_loop.run(_idle(args))
    return _results(seen, idle_share)


@asynccontextmanager
async def _daemon(ros2: dict[str, Any]) -> "AsyncIterator[Daemon]":
    sections = {
        "image": {"name": "auto"},
        "page": {"enabled": False},
        "metrics": {"enabled": False},
        "opcua": {"enabled": False},
        "ros2": ros2,
    }
    async with Daemon(assemble_config(Config.model_validate(sections))) as daemon:
        yield daemon


async def _idle(args: argparse.Namespace) -> float:
    """Return the processor time of a daemon without ROS 2, per second."""
    async with _daemon({"enabled": False}):
        await asyncio.sleep(SETTLE_S)
        return await _cpu_share(args.seconds)


async def _cpu_share(seconds: float) -> float:
    begin_s, before_s = time.monotonic(), time.process_time()
    await asyncio.sleep(seconds)
    return (time.process_time() - before_s) / (time.monotonic() - begin_s)


async def _measure(args: argparse.Namespace, fast_dds: Path, cyclone: Path) -> Seen:
    times, make, encode = (
        args.seconds * RATE_HZ,
        known_types().make,
        known_types().encode,
    )
    speeds = encode(make(RPM, **dict.fromkeys(_WHEELS, 20.0)))
    zero = make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    twist = encode(make(TWIST, linear=zero, angular=zero))
    command: Endpoint = ("w", COMMANDS, RPM, "reliable")
    references: list[Endpoint] = [
        ("r", f"rt/reference/{q}", TWIST, q) for q in REFERENCES
    ]
    ours = [("r", topic, kind, quality) for topic, kind, quality in published()]
    reader = Peer(fast_dds, args.domain, command, *ours, *references)
    taker = Peer(cyclone, args.domain, ("r", COMMANDS, RPM, "best_effort"))
    writers = [
        Peer(cyclone, args.domain, ("w", *endpoint[1:])) for endpoint in references
    ]
    peers = (taker, reader, *writers)
    node = {
        "enabled": True,
        "domain": args.domain,
        "publish": EXTRAS,
        "stale_after_ms": 10_000,
    }
    async with AsyncExitStack() as stack:
        daemon = await stack.enter_async_context(_daemon(node))
        if daemon.part("ros2") is None:
            raise FailedError("ROS 2 is not enabled")
        commands = daemon.part("ros2").status.one_way = Commands()
        for peer in peers:
            stack.push_async_callback(peer.end)
            await peer.start()
        await asyncio.sleep(SETTLE_S)
        reader.write(speeds, times)
        for writer in writers:
            writer.write(twist, times)
        before = daemon.part("ros2").status.writes
        cpu_share = await _cpu_share(args.seconds)
        rate_hz = (daemon.part("ros2").status.writes - before) / args.seconds
        real_time_factor = daemon.core.scheduler.statistics.tick.real_time_factor_total
    got = reader.streams()
    return Seen(
        ours={topic: got[topic] for _, topic, _, _ in ours},
        theirs={quality: got[f"rt/reference/{quality}"] for quality in REFERENCES},
        commands_us=commands.all_us,
        reference_commands_us=taker.streams()[COMMANDS].late_us,
        written=times,
        rate_hz=rate_hz,
        cpu_share=cpu_share,
        real_time_factor=real_time_factor,
    )


_WHEELS: Final = (
    "front_left_rpm",
    "front_right_rpm",
    "rear_left_rpm",
    "rear_right_rpm",
)


def _results(seen: Seen, idle_share: float) -> list[Result]:
    reliable = {topic for topic, _, quality in published() if quality == "reliable"}
    kinds = {
        "reliable": [s for topic, s in seen.ours.items() if topic in reliable],
        "best_effort": [s for topic, s in seen.ours.items() if topic not in reliable],
    }
    missing = [topic for topic, stream in seen.ours.items() if not stream.sequence]
    if missing or not all(seen.theirs[quality].sequence for quality in REFERENCES):
        raise FailedError(f"nothing came of {', '.join(missing) or 'the reference'}")
    name = "Cyclone C to Fast DDS"
    results = []
    for quality, streams in kinds.items():
        reference = seen.theirs[quality]
        lost_pct = (
            100.0 * sum(s.lost for s in streams) / sum(len(s.sequence) for s in streams)
        )
        reference_pct = 100.0 * reference.lost / len(reference.sequence)
        raw = {topic: stream.lost for topic, stream in seen.ours.items()}
        results.append(
            Result(
                f"ros2_{quality}_lost_pct", lost_pct, "%", reference_pct, name, raw=raw
            )
        )
        late = np.concatenate([np.array(s.late_us) for s in streams])
        results += _latencies(
            f"ros2_{quality}", late, np.array(reference.late_us), name
        )
    commands, theirs = np.array(seen.commands_us), np.array(seen.reference_commands_us)
    results += _latencies("ros2_command", commands, theirs, "Fast DDS to Cyclone C")
    lost, theirs_lost = (
        100.0 * (1.0 - len(c) / seen.written) for c in (commands, theirs)
    )
    results.append(
        Result("ros2_command_lost_pct", lost, "%", theirs_lost, "Fast DDS to Cyclone C")
    )
    results.append(
        Result("ros2_rate_hz", seen.rate_hz, "Hz", float(RATE_HZ), "asked for")
    )
    results.append(
        Result("ros2_real_time_factor", seen.real_time_factor, "1", 1.0, "real time")
    )
    cost_pct, idle_pct = 100.0 * seen.cpu_share, 100.0 * idle_share
    results.append(Result("ros2_cpu_pct", cost_pct, "%", idle_pct, "without ROS 2"))
    return results


def _latencies(name: str, ours: Times, reference: Times, what: str) -> list[Result]:
    results = []
    for percent in (50.0, 99.0):
        value, of_reference = (
            float(np.percentile(times, percent)) for times in (ours, reference)
        )
        full = f"{name}_latency_p{percent:g}_us"
        results.append(
            Result(full, value, "us", of_reference, what, value / of_reference)
        )
    return results

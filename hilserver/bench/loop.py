"""Set-point to output and back over TCP: two processes, both directions, the daemon as in use.

This process is the controller, an OPC UA server as on the IOT2050; the daemon is another process
that reads from it and writes to it. The set-point of one wheel changes sign at random moments. The
controller output ``wheel.fl.duty_pct`` follows in the same tick that latches the set-point, so the
first duty with the new sign that is written back marks the first published output that contains
the change. The measured time is from the change here to the arrival of that write here.
"""

import argparse
import asyncio
import contextlib
import math
import random
import tempfile
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hilserver.bench.report import Result
from hilserver.config.peers import PeerConfig
from hilserver.config.timing import SchedulerConfig
from hilserver.controller.nodes import SEQUENCE, demo_peer, node_id
from hilserver.controller.server import ControllerServer
from hilserver.errors import FailedError
from hilserver.program import children, event_loop
from hilserver.tasks import Supervisor
from hilserver.time_limit import time_limit

DUTY = "duty_FL"
PERIOD_S = 0.02
SPEED_RPM = 20.0
DAEMON_WITHIN_S = 120.0
DAEMON_ENDS_WITHIN_S = 20.0
ANSWER_LIMIT_S = 2.0
SETTLE_S = (0.15, 0.25)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``--changes`` and ``--seed``."""
    parser.add_argument(
        "--changes", type=int, default=200, help="set-point changes (%(default)s)"
    )
    parser.add_argument(
        "--seed", type=int, default=1, help="seed of the moments (%(default)s)"
    )


@dataclass
class LoopClient:
    """The controller's side of the measurement."""

    server: ControllerServer
    target_rpm: float = SPEED_RPM
    latencies_ms: list[float] = field(default_factory=list)  # one per change
    duty_pct: float = math.nan
    _sequence: int = 0
    _changed_ns: int | None = None
    _answered: asyncio.Event = field(default_factory=asyncio.Event)

    def on_duty(self, value: object) -> None:
        """Take a duty that the daemon wrote."""
        self.duty_pct = float(value) if isinstance(value, int | float) else math.nan
        if self._changed_ns is not None and self.duty_pct * self.target_rpm > 0:
            self.latencies_ms.append((time.monotonic_ns() - self._changed_ns) / 1e6)
            self._changed_ns = None
            self._answered.set()

    async def offer(self) -> None:
        """Serve the present set-points with the next sequence number."""
        self._sequence += 1
        wheels = dict.fromkeys(("FL", "RL"), self.target_rpm)
        wheels |= dict.fromkeys(("FR", "RR"), -self.target_rpm)
        values: dict[str, object] = {
            f"rpm_set_{name}": rpm for name, rpm in wheels.items()
        }
        control = {"enable": True, SEQUENCE: self._sequence}
        await self.server.offer(values | control, datetime.now(UTC))

    async def cycle(self) -> None:
        """Serve a set every 20 ms, as a controller does, until cancelled."""
        while True:
            await self.offer()
            await asyncio.sleep(PERIOD_S)

    async def ready(self, ended: Callable[[], str | None]) -> None:
        """Wait until the wheels turn as commanded; FailedError if the daemon does not start."""
        with contextlib.suppress(TimeoutError):
            async with time_limit(DAEMON_WITHIN_S):
                while not self.duty_pct * self.target_rpm > 0:
                    if (words := ended()) is not None:
                        raise FailedError(f"the daemon under test ended: {words}")
                    await asyncio.sleep(PERIOD_S)
                return
        raise FailedError(
            f"the daemon under test did not answer within {DAEMON_WITHIN_S:g} s"
        )

    async def change(self) -> None:
        """Change the sign of the set-point and wait for the answer.

        FailedError if no output contains the change within two seconds.
        """
        self._answered.clear()
        self.target_rpm = -self.target_rpm
        self._changed_ns = time.monotonic_ns()
        await self.offer()
        try:
            async with time_limit(ANSWER_LIMIT_S):
                await self._answered.wait()
        except TimeoutError:
            raise FailedError(
                "a set-point change did not come back within 2 s"
            ) from None


def peer(endpoint: str, mode: str) -> PeerConfig:
    """Return the peer of the demo, in `mode`, with the duty written back as well."""
    config = demo_peer(endpoint)
    write = config.write | {"wheel.fl.duty_pct": node_id(DUTY)}
    return config.changed(mode=mode, write=write)


@contextlib.asynccontextmanager
async def daemon(config: PeerConfig) -> AsyncIterator[Callable[[], str | None]]:
    """Run ``hilserver run`` against one peer; give a function that returns how it has ended."""
    document = {
        "image": {"name": "auto"},
        "opcua": {"enabled": False},
        "metrics": {"enabled": False},
        "page": {"enabled": False},
        "logging": {"level": "ERROR"},
        "peers": [config.model_dump(mode="json")],
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "config.yaml"
        log = Path(folder) / "log"
        path.write_text(yaml.safe_dump(document), encoding="utf-8")
        with log.open("wb") as stderr:
            command = children.python("-m", "hilserver", "run", "-c", str(path))
            async with children.started(
                command,
                name="hilserver run",
                stop_limit_s=DAEMON_ENDS_WITHIN_S,
                stderr=stderr,
            ) as process:

                def ended() -> str | None:
                    if process.returncode is None:
                        return None
                    text = log.read_text(encoding="utf-8").strip()
                    return text or f"exit code {process.returncode}"

                yield ended


async def measure(mode: str, changes: int, seed: int) -> list[float]:
    """Return the latency [ms] of `changes` set-point changes."""
    moments = random.Random(seed)  # noqa: S311 - phases of a measurement
    endpoint = "opc.tcp://127.0.0.1:0/UA/NodeRedAgv"
    async with ControllerServer(endpoint, more_sensors=[DUTY]) as server:
        loop = LoopClient(server)
        server.watch(DUTY, loop.on_duty)
        async with Supervisor() as tasks:
            tasks.keep("cycle", loop.cycle)
            async with daemon(peer(server.endpoint, mode)) as ended:
                await loop.ready(ended)
                for _ in range(changes):
                    await asyncio.sleep(moments.uniform(*SETTLE_S))
                    await loop.change()
    return loop.latencies_ms


def intervals(mode: str) -> dict[str, float]:
    """Return every interval [ms] that a change has to wait for, by name."""
    config = demo_peer("opc.tcp://127.0.0.1:1/")
    scheduler = SchedulerConfig()
    if mode == "subscribe":
        reading = {"publishing_ms": config.publishing_ms}
    else:
        reading = {"poll_ms": config.poll_ms}
    return reading | {
        "base_period_ms": scheduler.base_period_ms,
        "publish_slice_ms": scheduler.slices["publish"],
        "write_every_ms": config.write_every_ms,
    }


def run(args: argparse.Namespace) -> list[Result]:
    """Measure with a subscription, then polled."""
    results = []
    for mode, suffix in (("subscribe", ""), ("poll", "_poll")):
        latencies = np.array(event_loop.run(measure(mode, args.changes, args.seed)))
        waits = intervals(mode)
        raw: dict[str, Any] = {
            "mode": mode,
            "intervals": waits,
            "latencies_ms": [round(float(value), 3) for value in latencies],
        }
        named = ", ".join(f"{name} {value:g}" for name, value in waits.items())
        half = sum(waits.values()) / 2
        whole = sum(waits.values())
        for share, reference, what in ((50, half, "half of"), (99, whole, "sum of")):
            value = float(np.percentile(latencies, share))
            name = f"end_to_end{suffix}_p{share}_ms"
            reason = f"{what} {named}"
            results.append(
                Result(name, value, "ms", reference, reason, value / reference, raw)
            )
    return results

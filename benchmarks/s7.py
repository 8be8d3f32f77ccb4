"""A controller closes a 100 Hz loop over S7: age of its set-points, and round-trip time.

The controller is the server of python-snap7 in a process of its own. It sends counted set-points;
an own block of the plant passes each on, and it returns in the block that we write. The reference
is python-snap7's client, which sends back what it reads, at the same period and without a robot.
"""

import argparse
import asyncio
import json
import math
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.s7_controller import BYTES, COMING, GOING
from hilserver.bench.report import Result
from hilserver.compiled.histogram import BOUNDS_NS, Histogram125
from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.errors import FailedError
from hilserver.image import ProcessImage
from hilserver.plant.blocks import Output, block
from hilserver.program import event_loop
from hilserver.program.children import free_port

LIMIT_S = 60.0
SLICES_MS = {"plant": 1.0, "sensors": 10.0, "publish": 10.0, "supervise": 100.0}
LOOK_S = 0.2
LAST = BYTES - 4


@block(
    inputs=("value",), outputs=(Output("value", unit="rpm", low=-100.0, high=100.0),)
)
def echo(dt_s, u, y, x, p):  # type: ignore[no-untyped-def]  # noqa: ARG001
    """Pass the set-point on."""
    y[0] = u[0]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of this bench."""
    parser.add_argument(
        "--seconds", type=float, default=30.0, help="of each part (default 30)"
    )


def run(args: argparse.Namespace) -> list[Result]:
    """Measure, then the reference."""
    ours, ages_ms, faults, asked_ms = event_loop.run(_measure(args.seconds))
    reference = event_loop.run(_reference(args.seconds))
    age_raw = {
        "torn_reads": faults.get("torn_read", 0),
        "torn_at_controller": ours["torn"],
    }
    results = [
        Result(
            "s7_round_trips", len(ours["trips_ms"]), "", len(ours["sent_ns"]), "sent"
        ),
        Result("s7_setpoint_age_p99_ms", _percentile(ages_ms, 99), "ms", raw=age_raw),
        Result("s7_request_p99_ms", asked_ms, "ms"),
    ]
    for percent in (50, 99):
        value = _percentile(ours["trips_ms"], percent)
        other = _percentile(reference["trips_ms"], percent)
        results.append(
            Result(
                f"s7_round_trip_p{percent}_ms",
                value,
                "ms",
                other,
                "python-snap7, without a robot",
                value / other,
            )
        )
    return results


def _percentile(values: Sequence[float], percent: float) -> float:
    if not values:
        raise FailedError("nothing came back from the controller of the bench")
    return float(np.percentile(values, percent))


def _config(port: int) -> Config:
    ends = {"read": COMING, "write": GOING}
    heartbeat = {
        which: [f"DB{n},UDINT0", f"DB{n},UDINT{LAST}"] for which, n in ends.items()
    }
    peer = {
        "name": "plc",
        "endpoint": f"s7://127.0.0.1:{port}/0/1",
        "poll_ms": 10,
        "write_every_ms": 10,
        "heartbeat": heartbeat,
        "read": {
            f"DB{COMING},REAL4": "wheel.fl.setpoint_rpm",
            f"DB{COMING},REAL8": "wheel.fr.setpoint_rpm",
        },
        "write": {
            "echo.value": f"DB{GOING},REAL4",
            "wheel.fl.speed_rpm": f"DB{GOING},REAL8",
        },
    }
    inputs = {"value": "wheel.fl.setpoint_rpm"}
    own = {
        "name": "echo",
        "function": "benchmarks.s7:echo",
        "slice": "plant",
        "inputs": inputs,
    }
    return Config.model_validate(
        {
            "image": {"name": "auto", "ring_frames": 8192},
            "page": {"enabled": False},
            "metrics": {"enabled": False},
            "opcua": {"enabled": False},
            "scheduler": {
                "slices": {
                    "plant": 1.0,
                    "sensors": 10.0,
                    "publish": 10.0,
                    "supervise": 100.0,
                }
            },
            "blocks": [own],
            "peers": [peer],
        }
    )


async def _measure(
    seconds: float,
) -> tuple[dict[str, Any], list[float], Mapping[str, int], float]:
    port = free_port()
    async with Daemon(assemble_config(_config(port))) as daemon:
        status, latched = daemon.part("peers").status, dict[int, int]()
        slot = daemon.table.slot("input.sequence")
        controller = asyncio.create_task(_program("server", port, seconds))
        head = daemon.image.head
        while not controller.done():
            head = _first_seen(daemon.image, slot, head, latched)
            await asyncio.sleep(LOOK_S)
        found = controller.result()
        sent = found["sent_ns"]
        ages_ms = [
            (planned_ns - sent[number - 1]) * 1e-6
            for number, planned_ns in latched.items()
            if 0 < number <= len(sent)
        ]
        return found, ages_ms, status.fault_counts, _p99_ns(status.round_trip) * 1e-6


def _p99_ns(durations: Histogram125) -> float:
    """Return the upper bound of the bucket that holds the 99th percentile."""
    bucket = int(np.searchsorted(np.cumsum(durations.counts), 0.99 * durations.count))
    return float(BOUNDS_NS[bucket]) if bucket < len(BOUNDS_NS) else math.inf


def _first_seen(
    image: ProcessImage, slot: int, since: int, seen: dict[int, int]
) -> int:
    """Note the first tick [ns] with each number of the controller; return where to continue."""
    head = image.head
    for number in range(since, head):
        frame = image.frame(number)
        if frame is not None:
            seen.setdefault(int(frame.values[slot]), frame.planned_ns)
    return head


async def _reference(seconds: float) -> dict[str, Any]:
    port = free_port()
    controller = asyncio.create_task(_program("server", port, seconds))
    await asyncio.sleep(1.0)
    await _program("client", port, max(seconds - 2.0, 1.0))
    return await controller


async def _program(which: str, port: int, seconds: float) -> dict[str, Any]:
    module = ("-m", "benchmarks.s7_controller", which, str(port), str(seconds))
    process = await asyncio.create_subprocess_exec(
        sys.executable, *module, stdout=asyncio.subprocess.PIPE
    )
    try:
        async with asyncio.timeout(seconds + LIMIT_S):
            out, _ = await process.communicate()
    finally:
        if process.returncode is None:
            process.kill()
    found: dict[str, Any] = json.loads(out)
    return found

"""The "real robot" of ``hilserver run --twin``: another program's machine behind an OPC UA server.

It drives like the model until a cause appears that the daemon does not know. Its measured values
have the noise of real sensors; they and the set-points it follows carry their own timestamps.
"""

import argparse
import asyncio
import itertools
import math
import multiprocessing
import os
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Final

import numpy as np
from hilserver_injector import Recipe, Sensor, make
from numpy.typing import NDArray

import hilserver.scenarios  # noqa: F401 - makes the injector known where it is installed
from hilserver.config.peers import PeerConfig
from hilserver.controller.nodes import SEQUENCE, SETPOINTS, node_id
from hilserver.controller.server import ControllerServer
from hilserver.errors import EXIT_DONE
from hilserver.measured.channels import TAG
from hilserver.plant.layout import WHEELS
from hilserver.program import event_loop
from hilserver.program.workers import end_with_parent
from hilserver.signals import MEASURED
from hilserver.tasks import first_of

CAUSE: Final[Mapping[str, float]] = {"rotation_gain": 0.08}  # another floor
APPEARS_S: Final = 60.0
DRIVE_S: Final = 600.0
MEASURES: Final = (
    *(f"wheel.{w}.{what}" for what in ("speed_rpm", "duty_pct") for w in WHEELS),
    *TAG,
    "imu.gyro_z_rad_s",
    "battery.voltage_v",
)
# Set-points that jump would show the delay of a row rather than how the robot turns.
RAMPS: Final = Recipe(manoeuvre="ramps", sensors={"duty_pct": Sensor(limit=100.0)})
PUBLISHING_MS: Final = 5.0  # a quarter of a row
STALE_MS: Final = 10_000.0  # it may pause on a busy computer
AHEAD: Final = 50  # rows that are taken at once
LATE_S: Final = 0.02  # age from which a row is skipped, as the next one is due
Pose = NDArray[np.float64]


def peer(endpoint: str) -> PeerConfig:
    """Return the peer configuration for the robot at `endpoint`."""
    read: dict[str, str | tuple[str, ...]] = {
        node_id(node): (signal, f"{MEASURED}{signal}")
        if "setpoint" in signal
        else signal
        for node, signal in SETPOINTS.items()
    }
    read |= {node_id(name): f"{MEASURED}{name}" for name in MEASURES}
    return PeerConfig(
        name="robot",
        endpoint=endpoint,
        read=read,
        sequence_node=node_id(SEQUENCE),
        publishing_ms=PUBLISHING_MS,
        stale_after_ms=STALE_MS,
    )


@dataclass(frozen=True)
class DrivePiece:
    """One drive: its rows, and where it begins and ends."""

    length_s: float
    t_s: NDArray[np.float64]  # shape (n,)
    columns: Mapping[str, NDArray[np.float64]]
    first: Pose
    last: Pose


def piece(seed: int, length_s: float, causes: Mapping[str, float]) -> DrivePiece:
    """Make a drive."""
    table, truth = make(replace(RAMPS, seed=seed, causes=causes, duration_s=length_s))
    first = truth.dense[0, 1:4].copy()
    last = truth.dense[-1, 1:4].copy()
    return DrivePiece(length_s, table.t_s, table.columns, first, last)


def rows(seed: int) -> Iterator[tuple[float, dict[str, float]]]:
    """Yield time [s] and values of every row, without end; the cause appears at `APPEARS_S`."""
    begin_s = 0.0
    at = None
    for made in _pieces(seed):
        at = made.first if at is None else at
        tag = np.array([made.columns[name] for name in TAG])
        x, y, yaw = _pose(made.first, at, tag)
        columns = dict(made.columns) | dict(
            zip(TAG, (x, y, np.arctan2(np.sin(yaw), np.cos(yaw))), strict=True)
        )
        at = _pose(made.first, at, made.last)
        for k, t_s in enumerate(made.t_s.tolist()):
            values = {name: float(values[k]) for name, values in columns.items()}
            yield begin_s + t_s, {n: v for n, v in values.items() if math.isfinite(v)}
        begin_s += made.length_s


def _pieces(seed: int) -> Iterator[DrivePiece]:
    """Yield one drive after the other.

    The next one is made in a process of its own; in this one it would block the server for seconds.
    """
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, context, end_with_parent, (os.getpid(),)) as pool:
        coming = pool.submit(piece, seed, APPEARS_S, {})
        for number in itertools.count(1):
            now = coming
            coming = pool.submit(piece, seed + number, DRIVE_S, CAUSE)
            yield now.result()


def _pose(start: Pose, at: Pose, pose: Pose) -> Pose:
    """Return a pose of a drive that begins at `at` instead of `start`."""
    turn = at[2] - start[2]
    cos = math.cos(turn)
    sin = math.sin(turn)
    x = pose[0] - start[0]
    y = pose[1] - start[1]
    forward = cos * x - sin * y
    sideways = sin * x + cos * y
    return np.array([at[0] + forward, at[1] + sideways, pose[2] + turn])


async def drive(server: ControllerServer, seed: int) -> None:
    """Serve rows at their time.

    A robot does not catch up: rows that are overdue are skipped, and values that only they have are
    served with the next one.
    """
    loop = asyncio.get_running_loop()
    setpoints = {signal: node for node, signal in SETPOINTS.items()}
    nodes = setpoints | {n: n for n in MEASURES}
    source = rows(seed)
    begin_s = math.nan
    begun = datetime.now(UTC)
    sequence = 0
    offered: dict[str, object] = {}
    # in a thread: the first row compiles the injector
    while ahead := await asyncio.to_thread(
        lambda: list(itertools.islice(source, AHEAD))
    ):
        for t_s, values in ahead:
            if math.isnan(begin_s):
                begin_s = loop.time() - t_s
                begun = datetime.now(UTC) - timedelta(seconds=t_s)
            offered |= {nodes[n]: v for n, v in values.items() if n in nodes}
            left_s = begin_s + t_s - loop.time()
            if left_s < -LATE_S:
                continue
            await asyncio.sleep(left_s)
            sequence += 1
            await server.offer(
                {**offered, "enable": True, SEQUENCE: sequence % 2**32},
                begun + timedelta(seconds=t_s),
            )
            offered = {}


async def serve(endpoint: str, seed: int) -> int:
    """Serve and drive until SIGINT or SIGTERM."""
    async with ControllerServer(endpoint, more_sensors=MEASURES) as server:
        asked = event_loop.end_event()
        print(f"robot listening on {server.endpoint}", flush=True)
        await first_of(drive(server, seed), asked.wait())
    return EXIT_DONE


def main() -> int:
    """Run and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m hilserver.recalibration.robot")
    parser.add_argument("--endpoint", default="opc.tcp://127.0.0.1:0/UA/Robot")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    return event_loop.run(serve(args.endpoint, args.seed))


if __name__ == "__main__":
    raise SystemExit(main())

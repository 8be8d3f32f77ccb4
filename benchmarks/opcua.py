"""The cost of OPC UA clients, compared with asyncua's own server in the same run.

Each block starts with new clients, all subscribed to the same values, which change with every
publish slice; a small C program counts what arrives. The processor time is that of the whole server
process, plant included; the time without clients is given as well. Blocks of both servers
alternate.
"""

import argparse
import asyncio
import contextlib
import os
import statistics
import sys
import tempfile
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from asyncua import ua

from benchmarks.opcua_clients import Clients, Delivered, build
from benchmarks.target import running_daemon
from benchmarks.wire import Wire
from hilserver.bench.report import Result
from hilserver.program.children import free_port, piped, python

_RATE_HZ = 50.0
_QUEUE_SIZE = 10
_IDLE_S = 3.0
_ITEMS_PER_SIGNAL = 3
CHANGING = (
    *(f"wheel.{wheel}.angle_rad" for wheel in ("fl", "rl", "fr", "rr")),
    *("pose.x_m", "pose.y_m", "pose.yaw_rad", "imu.yaw_rad", "sim.tick", "sim.time_s"),
)
"""Signals that change in every tick while the robot drives an arc."""
_COMMANDS = (
    ("control.mode", 1, ua.VariantType.Byte),
    ("twist.linear_m_s", 0.2, ua.VariantType.Double),
    ("twist.angular_rad_s", 0.4, ua.VariantType.Double),
    ("drive.enable", True, ua.VariantType.Boolean),
)


@dataclass
class Subject:
    """A server and its measurements."""

    name: str
    url: str
    pid: int
    nodes: Sequence[ua.NodeId]
    cpu_s: list[float] = field(default_factory=list)
    delivered: list[Delivered] = field(default_factory=list)
    idle_load: float = 0.0
    resident_mb: float = 0.0

    def used_s(self) -> float:
        """Return the processor time of the process so far [s]."""
        words = (
            Path(f"/proc/{self.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        )
        return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")

    def memory_mb(self, what: str = "VmRSS") -> float:
        """Return a memory figure of the process [MB]."""
        for line in Path(f"/proc/{self.pid}/status").read_text(encoding="ascii").splitlines():
            if line.startswith(f"{what}:"):
                return int(line.split()[1]) * 1024 / 1e6
        return 0.0

    @property
    def cpu_per_value_us(self) -> float:
        """Median over the blocks [us]."""
        pairs = zip(self.cpu_s, self.delivered, strict=True)
        return 1e6 * statistics.median(cpu / max(got.values, 1) for cpu, got in pairs)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the size of the load."""
    parser.add_argument("--clients", type=int, default=20, help="subscribed clients")
    parser.add_argument("--blocks", type=int, default=5, help="blocks of each server")
    parser.add_argument("--block-s", type=float, default=5.0, help="length of a block")


async def _measure(args: argparse.Namespace) -> list[Subject]:
    async with contextlib.AsyncExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hilserver-")))
        program = build(folder)
        ours = await stack.enter_async_context(_ours())
        stock = await stack.enter_async_context(_stock())
        for subject in (ours, stock):
            before = subject.used_s()
            await asyncio.sleep(_IDLE_S)
            subject.idle_load = (subject.used_s() - before) / _IDLE_S
            subject.resident_mb = subject.memory_mb()
        for number in range(args.blocks):
            for subject in (ours, stock):
                print(f"block {number + 1}: {subject.name}", file=sys.stderr)
                await _block(subject, args, program)
        return [ours, stock]


async def _block(subject: Subject, args: argparse.Namespace, program: Path) -> None:
    clients = Clients(subject.url)
    try:
        await clients.subscribe(args.clients, subject.nodes, 1e3 / _RATE_HZ, _QUEUE_SIZE)
        before_s = subject.used_s()
        delivered = await clients.run(program, args.block_s)
        subject.cpu_s.append(subject.used_s() - before_s)
        subject.delivered.append(delivered)
    finally:
        clients.close()
    await asyncio.sleep(1.0)


@contextlib.asynccontextmanager
async def _ours() -> AsyncIterator[Subject]:
    async with running_daemon({}, f"bench-opcua-{os.getpid()}") as (url, daemon):
        async with Wire(url) as wire:
            await wire.log_in()
            for name, value, kind in _COMMANDS:
                await wire.write(ua.NodeId(name, 2), value, kind)
        nodes = [ua.NodeId(name, 2) for name in CHANGING] * _ITEMS_PER_SIGNAL
        yield Subject("hilserver", url, daemon.pid, nodes)


@contextlib.asynccontextmanager
async def _stock() -> AsyncIterator[Subject]:
    port = free_port()
    arguments = ["-m", "benchmarks.opcua_stock", str(port), str(len(CHANGING)), str(_RATE_HZ)]
    with piped(python(*arguments), name="the stock server") as process:
        assert process.stdout is not None
        await asyncio.to_thread(process.stdout.readline)
        nodes = [ua.NodeId(f"n{number}", 2) for number in range(len(CHANGING))]
        nodes *= _ITEMS_PER_SIGNAL
        yield Subject("asyncua", f"opc.tcp://127.0.0.1:{port}/stock", process.pid, nodes)


def run(args: argparse.Namespace) -> list[Result]:
    """Measure, and return the figures."""
    ours, stock = asyncio.run(_measure(args))
    expected = args.clients * len(CHANGING) * _ITEMS_PER_SIGNAL * _RATE_HZ * args.block_s
    costs = [subject.cpu_per_value_us for subject in (ours, stock)]
    name = "stock asyncua"
    raw = {
        subject.name: {
            "cpu_s": subject.cpu_s,
            "delivered": [got._asdict() for got in subject.delivered],
            "idle_load": subject.idle_load,
        }
        for subject in (ours, stock)
    }
    found = [Result("cpu_per_value_us", costs[0], "us", costs[1], name, costs[0] / costs[1], raw)]
    for what, figures in (
        ("delivered_share", [_median_values(s) / expected for s in (ours, stock)]),
        ("load_when_watched", [statistics.median(s.cpu_s) / args.block_s for s in (ours, stock)]),
        ("load_when_idle", [s.idle_load for s in (ours, stock)]),
    ):
        found.append(Result(what, figures[0], "1", figures[1], name, figures[0] / figures[1]))
    found.append(Result("resident_mb", ours.resident_mb, "MB", stock.resident_mb, name))
    return found


def _median_values(subject: Subject) -> float:
    return statistics.median(got.values for got in subject.delivered)

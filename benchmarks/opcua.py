"""The cost of OPC UA clients, beside asyncua's own server and open62541's in the same run.

open62541 is a reference where its library is installed, found by ``pkg-config open62541``.

Each block starts with new clients, all subscribed to the same values, which change with every
publish slice; a small C program counts what arrives. The processor time is that of the whole server
process, plant included; the time without clients is given as well. Blocks of both servers
alternate. A server that delivers less than 95 % is saturated, and what a value costs it is no
figure: it gets half as many clients until it keeps up.
"""

import argparse
import asyncio
import contextlib
import os
import statistics
import sys
import tempfile
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from asyncua import ua

from benchmarks.opcua_clients import Clients, Delivered, build, build_open62541
from benchmarks.target import running_daemon
from benchmarks.wire import Wire
from hilserver.bench.report import Result
from hilserver.errors import FailedError
from hilserver.program.children import free_port, piped, python

_RATE_HZ = 50.0
_QUEUE_SIZE = 10
_IDLE_S = 3.0
_RENEW_S = 1.0
_LEAST_SHARE = 0.95
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
    driving: "asyncio.Task[None] | None" = None  # what keeps the values changing
    n_clients: int = 0  # as many as it can serve
    idle_load: float = 0.0
    resident_mb: float = 0.0

    def used_s(self) -> float:
        """Return the processor time of the process so far [s]."""
        words = (
            Path(f"/proc/{self.pid}/stat")
            .read_text(encoding="ascii")
            .rpartition(")")[2]
            .split()
        )
        return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")

    def memory_mb(self, what: str = "VmRSS") -> float:
        """Return a memory figure of the process [MB]."""
        for line in (
            Path(f"/proc/{self.pid}/status").read_text(encoding="ascii").splitlines()
        ):
            if line.startswith(f"{what}:"):
                return int(line.split()[1]) * 1024 / 1e6
        return 0.0

    @property
    def cpu_per_value_us(self) -> float:
        """Median over the blocks [us]."""
        pairs = zip(self.cpu_s, self.delivered, strict=True)
        return 1e6 * statistics.median(cpu / max(got.values, 1) for cpu, got in pairs)

    def delivered_share(self, block_s: float) -> float:
        """Return values that came in per value that changed, median over the blocks."""
        changed = self.n_clients * len(self.nodes) * _RATE_HZ * block_s
        return statistics.median(got.values for got in self.delivered) / changed

    def figures(self, block_s: float) -> dict[tuple[str, str], float]:
        """Return what is compared, by name and unit."""
        return {
            ("cpu_per_value_us", "us"): self.cpu_per_value_us,
            ("delivered_share", "1"): self.delivered_share(block_s),
            ("load_when_watched", "1"): statistics.median(self.cpu_s) / block_s,
            ("load_when_idle", "1"): self.idle_load,
            ("resident_mb", "MB"): self.resident_mb,
        }


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the size of the load."""
    parser.add_argument("--clients", type=int, default=20, help="subscribed clients")
    parser.add_argument("--blocks", type=int, default=5, help="blocks of each server")
    parser.add_argument("--block-s", type=float, default=5.0, help="length of a block")


async def _measure(args: argparse.Namespace) -> list[Subject]:
    async with contextlib.AsyncExitStack() as stack:
        folder = Path(
            stack.enter_context(tempfile.TemporaryDirectory(prefix="hilserver-"))
        )
        program = build(folder)
        references = [("asyncua", 2, python("-m", "benchmarks.opcua_stock"))]
        compiled = build_open62541(folder)
        if compiled is not None:
            references.append(("open62541", 1, [str(compiled)]))
        subjects = [await stack.enter_async_context(_ours())]
        subjects += [
            await stack.enter_async_context(_other(*reference))
            for reference in references
        ]

        for subject in subjects:
            before = subject.used_s()
            await asyncio.sleep(_IDLE_S)
            subject.idle_load = (subject.used_s() - before) / _IDLE_S
            subject.resident_mb = subject.memory_mb()
            await _find_clients(subject, args, program)
        for number in range(args.blocks):
            for subject in subjects:
                print(
                    f"block {number + 1}: {subject.name}, {subject.n_clients} clients",
                    file=sys.stderr,
                )
                await _block(subject, args.block_s, program)
        return subjects


async def _find_clients(
    subject: Subject, args: argparse.Namespace, program: Path
) -> None:
    """Find how many clients a server can serve, none of its trials being part of the figures."""
    subject.n_clients = args.clients
    while True:
        await _block(subject, args.block_s, program)
        share = subject.delivered_share(args.block_s)
        subject.cpu_s.clear()
        subject.delivered.clear()
        if share >= _LEAST_SHARE or subject.n_clients == 1:
            return
        print(
            f"{subject.name} delivers {share:.0%} to {subject.n_clients} clients: half as many",
            file=sys.stderr,
        )
        subject.n_clients //= 2


async def _block(subject: Subject, block_s: float, program: Path) -> None:
    clients = Clients(subject.url)
    try:
        await clients.subscribe(
            subject.n_clients, subject.nodes, 1e3 / _RATE_HZ, _QUEUE_SIZE
        )
        before_s = subject.used_s()
        delivered = await clients.run(program, block_s)
        subject.cpu_s.append(subject.used_s() - before_s)
        subject.delivered.append(delivered)
        # a robot that stands changes a fifth of the values: that would look like lost ones
        if subject.driving is not None and subject.driving.done():
            subject.driving.result()
    finally:
        clients.close()
    await asyncio.sleep(1.0)


@contextlib.asynccontextmanager
async def _ours() -> AsyncIterator[Subject]:
    async with (
        running_daemon({}, f"bench-opcua-{os.getpid()}") as (url, daemon),
        Wire(url) as wire,
    ):
        await wire.log_in()
        await _command(wire)
        driving = asyncio.create_task(_drive_on(wire))
        try:
            nodes = [ua.NodeId(name, 2) for name in CHANGING] * _ITEMS_PER_SIGNAL
            yield Subject("hilserver", url, daemon.pid, nodes, driving=driving)
        finally:
            driving.cancel()


async def _command(wire: Wire) -> None:
    """Let the robot drive an arc; FailedError if the daemon does not take the commands."""
    for name, value, kind in _COMMANDS:
        status = await wire.write(ua.NodeId(name, 2), value, kind)
        if status != "Good":
            raise FailedError(
                f"the daemon does not take {name}: {status}; after an overrun of its tick it is in"
                " the safe state: run the bench on a computer with nothing else to do"
            )


async def _drive_on(wire: Wire) -> None:
    """Renew the commands: without its client the robot stands, and what stands is not sent."""
    while True:
        await asyncio.sleep(_RENEW_S)
        await _command(wire)


@contextlib.asynccontextmanager
async def _other(
    name: str, namespace: int, command: Sequence[str]
) -> AsyncIterator[Subject]:
    """Run another server, which takes a port, a number of nodes and a rate."""
    port = free_port()
    words = [*command, str(port), str(len(CHANGING)), str(_RATE_HZ)]
    with piped(words, name=f"the server of {name}") as process:
        assert process.stdout is not None
        await asyncio.to_thread(process.stdout.readline)
        nodes = [ua.NodeId(f"n{number}", namespace) for number in range(len(CHANGING))]
        nodes *= _ITEMS_PER_SIGNAL
        yield Subject(name, f"opc.tcp://127.0.0.1:{port}", process.pid, nodes)


def run(args: argparse.Namespace) -> list[Result]:
    """Measure, and return the figures; FailedError if this computer has no room for the load."""
    return figures(*asyncio.run(_measure(args)), block_s=args.block_s)


def figures(ours: Subject, *references: Subject, block_s: float) -> list[Result]:
    """Return the figures, each once for every reference.

    A reference that does not keep up has none. FailedError if our own server does not.
    """
    share = ours.delivered_share(block_s)
    if share < _LEAST_SHARE:
        raise FailedError(
            f"{share:.0%} of the values were delivered to {ours.n_clients} clients: a figure"
            f" needs {_LEAST_SHARE:.0%}; run the bench on a computer with nothing else to do"
        )
    raw = {
        subject.name: {
            "clients": subject.n_clients,
            "cpu_s": subject.cpu_s,
            "delivered": [got._asdict() for got in subject.delivered],
            "idle_load": subject.idle_load,
        }
        for subject in (ours, *references)
    }
    found = []
    for other in references:
        kept_up = other.delivered_share(block_s)
        name = f"{other.name}, {other.n_clients} of {ours.n_clients} clients"
        if kept_up < _LEAST_SHARE:
            name = f"{other.name} delivers {kept_up:.0%} to a single client: no figure"

        theirs = other.figures(block_s)
        suffix = "" if other is references[0] else f"_{other.name}"
        for (what, unit), value in ours.figures(block_s).items():
            reference = theirs[what, unit] if kept_up >= _LEAST_SHARE else None
            ratio = value / reference if reference else None
            found.append(Result(what + suffix, value, unit, reference, name, ratio))
    found[0] = replace(found[0], raw=raw)
    return found

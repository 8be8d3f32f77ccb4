"""The OPC UA server under attack: malformed packets and floods, beside a healthy client.

The daemon, the healthy client and the attacker are three processes on loopback. Idle blocks and
blocks of attack alternate, so that both see the same machine. Every packet goes over a connection
of its own; what the server does not answer or close within its read deadline is counted.
"""

import argparse
import asyncio
import contextlib
import json
import os
import re
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import IO, Any

import yaml
from asyncua import ua

from hilserver.bench.attack_floods import FLOODS
from hilserver.bench.attack_packets import STAGES, Packet, packets
from hilserver.bench.poisson import rate_ratio_interval
from hilserver.bench.report import Result
from hilserver.bench.wire import Wire
from hilserver.errors import FailedError
from hilserver.image import ImageReader
from hilserver.scheduler import Statistics

READ_DEADLINE_S = 2.0
NO_ANSWER = "no answer"
_MOST_KEPT = 20
_ATTACKER_NICENESS = 10
START_WITHIN_S = 120.0
_AT_ONCE = 60
_PER_BLOCK = 2000
_WARM_UP = 400
_DAEMON = "import sys; from hilserver.commands import main; sys.exit(main(sys.argv[1:]))"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the size of the attack."""
    parser.add_argument("--packets", type=int, default=20_000, help="malformed packets")
    parser.add_argument("--seed", type=int, default=1, help="of the generator")
    parser.add_argument("--idle-s", type=float, default=8.0, help="length of an idle block")
    parser.add_argument("--flood-s", type=float, default=8.0, help="length of a flood")


@dataclass
class Block:
    """One block: what happened in it."""

    name: str
    duration_s: float
    missed_ticks: int
    reads_ms: list[float]
    memory_mb: float


@dataclass
class Campaign:
    """All blocks, and what became of the packets."""

    blocks: list[Block] = field(default_factory=list)
    sent: dict[str, int] = field(default_factory=lambda: dict.fromkeys(STAGES, 0))
    outcomes: dict[str, int] = field(default_factory=dict)
    slowest_s: float = 0.0
    not_sent: int = 0
    unanswered: list[str] = field(default_factory=list)
    baseline_mb: float = 0.0

    def count(self, packet: Packet, outcome: str, duration_s: float) -> None:
        """Count one packet."""
        self.sent[packet.stage] += 1
        self.outcomes[outcome] = self.outcomes.get(outcome, 0) + 1
        self.slowest_s = max(self.slowest_s, duration_s)
        if outcome == NO_ANSWER and len(self.unanswered) < _MOST_KEPT:
            self.unanswered.append(f"{packet.stage}: {packet.data[:400].hex()}")


# --- packets --------------------------------------------------------------------------------------


async def send_packets(url: str, some: Iterator[Packet], campaign: Campaign) -> None:
    """Send packets over many connections at once."""

    async def work() -> None:
        for packet in some:
            for _ in range(20):
                try:
                    await _send(url, packet, campaign)
                    break
                except (OSError, TimeoutError, ua.UaError):
                    await asyncio.sleep(0.1)  # no place free for the valid part before it
            else:
                campaign.not_sent += 1

    await asyncio.gather(*(work() for _ in range(_AT_ONCE)))


async def _send(url: str, packet: Packet, campaign: Campaign) -> None:
    async with Wire(url) as wire:
        stage = STAGES.index(packet.stage)
        if stage >= 1:
            await wire.greet()
        if stage >= 2:
            await wire.open()
        if stage >= 3:
            await wire.create_session()
            await wire.activate_session()
        data = packet.data
        if packet.keeps_head:
            sequence = wire._sequence + 1
            head = struct.pack("<IIII", wire.channel, wire.token, sequence, sequence)
            data = data[:8] + head + data[24:]
        began = time.monotonic()
        outcome = await _outcome(wire, data)
        campaign.count(packet, outcome, time.monotonic() - began)


async def _outcome(wire: Wire, data: bytes) -> str:
    try:
        await wire.send(data)
        kind, body = await wire.receive(within_s=READ_DEADLINE_S)
    except TimeoutError:
        return NO_ANSWER
    except OSError:
        return "closed"
    if kind == b"ERR" and len(body) >= 4:
        return str(ua.StatusCode(struct.unpack_from("<I", body)[0]).name)
    return f"answered {kind.decode('ascii', 'replace')}" if kind else "closed"


# --- the three processes --------------------------------------------------------------------------


@dataclass
class Target:
    """The daemon and the healthy client."""

    url: str
    daemon: "subprocess.Popen[str]"
    probe: "subprocess.Popen[str]"
    statistics: Statistics

    @property
    def missed_ticks(self) -> int:
        """Ticks of the plant that did not take place."""
        return self.statistics.tick.missed_ticks

    @property
    def memory_mb(self) -> float:
        """Resident memory of the daemon."""
        status = Path(f"/proc/{self.daemon.pid}/status").read_text(encoding="ascii")
        found = re.search(r"VmRSS:\s+(\d+)", status)
        return int(found[1]) / 1024 if found else 0.0

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
            raise FailedError(f"the daemon ended with code {self.daemon.returncode}: a crash")


def _pipes(process: "subprocess.Popen[str]") -> tuple[IO[str], IO[str]]:
    assert process.stdin is not None
    assert process.stdout is not None
    return process.stdin, process.stdout


@contextlib.asynccontextmanager
async def target() -> AsyncIterator[Target]:
    """Start a daemon on a free port and a healthy client."""
    with (
        tempfile.TemporaryDirectory(prefix="hilserver-") as folder,
        contextlib.ExitStack() as stack,
    ):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            url = f"opc.tcp://127.0.0.1:{free.getsockname()[1]}/hilserver"
        image = f"bench-attack-{os.getpid()}"
        path = Path(folder) / "config.yaml"
        settings: dict[str, Any] = {
            "scheduler": {"policy": "skip"},  # every late tick is one missed tick
            "image": {"name": image},
            "opcua": {"endpoint": url},
            "metrics": {"enabled": False},
            "logging": {"level": "ERROR"},
        }
        path.write_text(yaml.safe_dump(settings), encoding="utf-8")
        daemon = stack.enter_context(_process(["-c", _DAEMON, "run", "-c", str(path)]))
        await _wait_for_server(url, daemon)
        probe = stack.enter_context(_process(["-m", "hilserver.bench.attack_probe", url]))
        _, words = ImageReader.attach(image).region("statistics")
        subject = Target(url, daemon, probe, Statistics.attach(words))
        await asyncio.sleep(1.0)
        subject.reads_ms()
        yield subject


@contextlib.contextmanager
def _process(arguments: list[str]) -> "Iterator[subprocess.Popen[str]]":
    process = subprocess.Popen(  # noqa: S603 - our own program
        [sys.executable, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.terminate()
        try:
            process.communicate(timeout=20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()


async def _wait_for_server(url: str, daemon: "subprocess.Popen[str]") -> None:
    deadline = time.monotonic() + START_WITHIN_S
    while time.monotonic() < deadline and daemon.poll() is None:
        with contextlib.suppress(OSError, ua.UaError, TimeoutError):
            async with Wire(url) as wire:
                await wire.log_in()
                value = (await wire.read(ua.NodeId("sim.state", 2)))[0].Value
                if value is not None and value.Value == 1:  # running
                    return
        await asyncio.sleep(0.2)
    raise FailedError(f"the daemon did not start within {START_WITHIN_S:.0f} s")


# --- the campaign ---------------------------------------------------------------------------------


async def attack(args: argparse.Namespace) -> Campaign:
    """Run the whole campaign, idle blocks in between."""
    campaign = Campaign()
    async with target() as subject:
        # The attacker stands for another computer: it must not take the plant's core itself.
        os.nice(_ATTACKER_NICENESS)
        # Caches fill and memory settles before the baseline is taken.
        await send_packets(subject.url, packets(_WARM_UP, args.seed + 1), Campaign())
        subject.reads_ms()
        campaign.baseline_mb = subject.memory_mb
        generated = packets(args.packets, args.seed)
        left = args.packets
        floods = iter(FLOODS.items())
        while left > 0 or floods is not None:
            await _block(campaign, subject, "idle", asyncio.sleep(args.idle_s))
            if left > 0:
                some = islice(generated, min(left, _PER_BLOCK))
                left -= _PER_BLOCK
                await _block(
                    campaign, subject, "packets", send_packets(subject.url, some, campaign)
                )
                await _block(campaign, subject, "idle", asyncio.sleep(args.idle_s))
            name, flood = next(floods, ("", None))
            if flood is not None:
                end_s = time.monotonic() + args.flood_s
                await _block(campaign, subject, name, flood(subject.url, end_s))
            elif left <= 0:
                break
        await asyncio.sleep(READ_DEADLINE_S)
        await _block(campaign, subject, "idle", asyncio.sleep(args.idle_s))
    return campaign


async def _block(campaign: Campaign, subject: Target, name: str, work: Any) -> None:
    print(f"block {len(campaign.blocks) + 1}: {name}", file=sys.stderr)
    await asyncio.to_thread(subject.reads_ms)
    began_s, missed = time.monotonic(), subject.missed_ticks
    peak_mb = subject.memory_mb
    task = asyncio.ensure_future(work)
    while not task.done():
        await asyncio.wait((task,), timeout=0.2)
        subject.check()
        peak_mb = max(peak_mb, subject.memory_mb)
    task.result()
    duration_s = time.monotonic() - began_s
    missed = subject.missed_ticks - missed
    reads_ms = await asyncio.to_thread(subject.reads_ms)
    campaign.blocks.append(Block(name, duration_s, missed, reads_ms, peak_mb))


def run(args: argparse.Namespace) -> list[Result]:
    """Attack, and return the figures."""
    return results(asyncio.run(attack(args)))


def results(campaign: Campaign) -> list[Result]:
    """Return the figures of a campaign."""
    idle = [block for block in campaign.blocks if block.name == "idle"]
    busy = [block for block in campaign.blocks if block.name != "idle"]
    raw = {
        "sent": campaign.sent,
        "outcomes": dict(sorted(campaign.outcomes.items(), key=lambda row: -row[1])),
        "not_sent": campaign.not_sent,
        "unanswered": campaign.unanswered,
        "slowest_s": campaign.slowest_s,
        "blocks": [
            {
                "name": block.name,
                "duration_s": round(block.duration_s, 2),
                "missed_ticks": block.missed_ticks,
                "reads": len(block.reads_ms),
                "read_p99_ms": _percentile(block.reads_ms, 0.99),
                "peak_memory_mb": round(block.memory_mb, 1),
            }
            for block in campaign.blocks
        ],
    }
    growth = max(block.memory_mb for block in campaign.blocks) - campaign.baseline_mb
    found = [
        Result("malformed_packets", sum(campaign.sent.values()), "1", raw=raw),
        Result("unanswered_packets", campaign.outcomes.get(NO_ANSWER, 0), "1"),
        Result("slowest_answer_s", campaign.slowest_s, "s", READ_DEADLINE_S, "read deadline"),
        Result("memory_growth_mb", growth, "MB", campaign.baseline_mb, "before the attack"),
    ]
    for percent in (50, 99):
        value = _percentile([ms for block in busy for ms in block.reads_ms], percent / 100)
        reference = _percentile([ms for block in idle for ms in block.reads_ms], percent / 100)
        ratio = value / reference if reference else None
        found.append(
            Result(f"healthy_read_p{percent}_ms", value, "ms", reference, "idle blocks", ratio)
        )
    return [*found, *_missed(busy, idle)]


def _missed(busy: list[Block], idle: list[Block]) -> list[Result]:
    counts = [sum(block.missed_ticks for block in blocks) for blocks in (busy, idle)]
    times_s = [sum(block.duration_s for block in blocks) for blocks in (busy, idle)]
    rates = [count / time_s for count, time_s in zip(counts, times_s, strict=True)]
    low, high = rate_ratio_interval(counts[0], times_s[0], counts[1], times_s[1])
    ratio = rates[0] / rates[1] if rates[1] else None
    return [
        Result("missed_ticks_per_s", rates[0], "1/s", rates[1], "idle blocks", ratio,
               {"counts": counts, "times_s": times_s}),
        Result("missed_ticks_rate_ratio_low", low, "1", 1.0, "95 % interval"),
        Result("missed_ticks_rate_ratio_high", min(high, 1e9), "1", 1.0, "95 % interval"),
    ]  # fmt: skip


def _percentile(values: list[float], part: float) -> float:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(part * len(ordered)))] if ordered else 0.0

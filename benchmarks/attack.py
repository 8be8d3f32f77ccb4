"""The OPC UA server under attack: malformed packets and floods, next to a healthy client.

The daemon, the healthy client and the attacker are processes on loopback. Blocks alternate so that
all see the same conditions: idle, attack, and as a control the same load on a second daemon,
because on one computer any load costs the plant something. With two cores the pacing thread has one
for itself: attacker and client represent other computers. Every packet has a connection of its own;
connections that the server neither answers nor closes are counted, and the slowest answer is
compared with its read deadline.
"""

import argparse
import asyncio
import contextlib
import itertools
import os
import struct
import sys
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path

from asyncua import ua

from benchmarks.attack_figures import (
    ATTACK,
    CONTROL,
    IDLE,
    NO_ANSWER,
    READ_DEADLINE_S,
    Block,
    Campaign,
    results,
)
from benchmarks.attack_floods import FLOODS
from benchmarks.attack_packets import STAGES, Packet, packets
from benchmarks.attack_target import (
    Target,
    core_for_the_plant,
    running_control,
    running_target,
)
from benchmarks.wire import Wire
from hilserver.bench.report import Result

_ATTACKER_NICENESS = 10
_AT_ONCE = 60
_PER_BLOCK = 2000
_WARM_UP = 400
_UNANSWERED_S = 10 * READ_DEADLINE_S
"""A busy computer may delay both ends for seconds."""

Work = Callable[[str, Campaign], Awaitable[None]]
"""An attack on the daemon at an address; the fate of packets is counted in the campaign."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the size of the attack."""
    parser.add_argument("--packets", type=int, default=20_000, help="malformed packets")
    parser.add_argument("--seed", type=int, default=1, help="of the generator")
    parser.add_argument(
        "--idle-s", type=float, default=5.0, help="length of an idle block"
    )
    parser.add_argument("--flood-s", type=float, default=5.0, help="length of a flood")
    parser.add_argument(
        "--rounds", type=int, default=3, help="how often each flood comes"
    )
    parser.add_argument(
        "--no-control",
        action="store_true",
        help="without the same load on a second daemon",
    )
    parser.add_argument(
        "--anywhere",
        action="store_true",
        help="leave it to the system which core runs what",
    )


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
                    # no connection free for the valid part before it
                    await asyncio.sleep(0.1)
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
        kind, body = await wire.receive(within_s=_UNANSWERED_S)
    except TimeoutError:
        return NO_ANSWER
    except OSError:
        return "closed"
    if kind == b"ERR" and len(body) >= 4:
        return str(ua.StatusCode(struct.unpack_from("<I", body)[0]).name)
    return f"answered {kind.decode('ascii', 'replace')}" if kind else "closed"


# --- the campaign ---------------------------------------------------------------------------------


def _pieces(args: argparse.Namespace) -> Iterator[tuple[str, Work]]:
    """Yield packets and floods in turn until both have ended."""

    def sending(first: int) -> Work:
        async def send(url: str, campaign: Campaign) -> None:
            some = itertools.islice(
                packets(args.packets, args.seed), first, first + _PER_BLOCK
            )
            await send_packets(url, some, campaign)

        return send

    def flooding(flood: Callable[[str, float], Awaitable[None]]) -> Work:
        return lambda url, _: flood(url, time.monotonic() + args.flood_s)

    parts = [
        ("packets", sending(first)) for first in range(0, args.packets, _PER_BLOCK)
    ]
    floods = [(name, flooding(flood)) for name, flood in FLOODS.items()] * args.rounds
    for pair in itertools.zip_longest(parts, floods):
        yield from (piece for piece in pair if piece is not None)


async def attack(args: argparse.Namespace) -> Campaign:
    """Run the whole campaign."""
    campaign = Campaign(plant_core=None if args.anywhere else core_for_the_plant())

    async def idle(_url: str, _: Campaign) -> None:
        await asyncio.sleep(args.idle_s)

    async with contextlib.AsyncExitStack() as stack:
        subject = await stack.enter_async_context(running_target(campaign.plant_core))
        other = (
            None
            if args.no_control
            else await stack.enter_async_context(running_control())
        )
        campaign.pacing_priority = subject.pacing_priority
        # The attacker represents another computer: it must not itself take the plant's core.
        os.nice(_ATTACKER_NICENESS)
        # Caches must fill and memory settle before the baseline is taken.
        await send_packets(subject.url, packets(_WARM_UP, args.seed + 1), Campaign())
        subject.reads_ms()
        campaign.baseline_mb = subject.memory_mb
        for name, work in _pieces(args):
            await _block(campaign, subject, IDLE, IDLE, idle(subject.url, campaign))
            await _block(campaign, subject, ATTACK, name, work(subject.url, campaign))
            if other is not None:
                await _block(campaign, subject, CONTROL, name, work(other, Campaign()))
        await asyncio.sleep(READ_DEADLINE_S)
        await _block(campaign, subject, IDLE, IDLE, idle(subject.url, campaign))
    return campaign


async def _block(
    campaign: Campaign, subject: Target, kind: str, name: str, work: Awaitable[None]
) -> None:
    print(f"block {len(campaign.blocks) + 1}: {kind}, {name}", file=sys.stderr)
    await asyncio.to_thread(subject.reads_ms)
    began_s, missed, stolen_s = time.monotonic(), subject.missed_ticks, _stolen_s()
    peak_mb = subject.memory_mb
    subject.peer.ages_ms()
    ages_ms: list[float] = []
    safe_ticks = subject.peer.safe_ticks
    task = asyncio.ensure_future(work)
    while not task.done():
        await asyncio.wait((task,), timeout=0.2)
        subject.check()
        ages_ms += subject.peer.ages_ms()
        peak_mb = max(peak_mb, subject.memory_mb)
    task.result()
    duration_s = time.monotonic() - began_s
    missed, stolen_s = subject.missed_ticks - missed, _stolen_s() - stolen_s
    reads_ms = await asyncio.to_thread(subject.reads_ms)
    safe_ticks = subject.peer.safe_ticks - safe_ticks
    campaign.blocks.append(
        Block(
            kind,
            name,
            duration_s,
            missed,
            reads_ms,
            peak_mb,
            stolen_s,
            ages_ms,
            safe_ticks,
        )
    )


def _stolen_s() -> float:
    """Return the processor time of all cores that the hypervisor gave to others so far."""
    words = Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0].split()
    return int(words[8]) / os.sysconf("SC_CLK_TCK")


def run(args: argparse.Namespace) -> list[Result]:
    """Attack, and return the figures."""
    return results(asyncio.run(attack(args)))

"""Peers that are no OPC UA servers at all: the link says so, tries again, and stays small."""

import asyncio
import contextlib
import os
import struct

import pytest

from tests.helpers.daemons import free_port
from tests.io.opcua_client.conftest import make_harness, peer_config, wait_until
from tests.node_red.resources import Holdings


async def silent(reader, writer):
    await reader.read(-1)


async def hangs_up(reader, writer):
    writer.close()


async def garbage(reader, writer):
    await reader.read(32)
    writer.write(os.urandom(4096))
    await writer.drain()
    await reader.read(-1)


async def error_message(reader, writer):
    await reader.read(32)
    reason = b"go away"
    body = struct.pack("<II", 0x80010000, len(reason)) + reason
    writer.write(b"ERRF" + struct.pack("<I", 8 + len(body)) + body)
    await writer.drain()
    await reader.read(-1)


SENT_MIB: list[int] = []


async def endless(reader, writer):
    """Announce two gigabytes and send what a link of a gigabit would carry."""
    await reader.read(32)
    writer.write(b"ACKF" + struct.pack("<I", 2**31 - 1))
    block = bytes(1024 * 1024)
    for _ in range(2048):
        writer.write(block)
        await writer.drain()
        SENT_MIB.append(1)
        await asyncio.sleep(0.008)


@pytest.mark.parametrize(
    "behaviour", [silent, hangs_up, garbage, error_message, endless]
)
async def test_link_survives(behaviour):
    connections = 0

    async def serve(reader, writer):
        nonlocal connections
        connections += 1
        with contextlib.suppress(OSError):
            await behaviour(reader, writer)
        writer.close()

    port = free_port()
    server = await asyncio.start_server(serve, "127.0.0.1", port)
    harness = make_harness(peer_config(port))
    before = Holdings.of()
    await harness.link.start()
    try:
        await wait_until(lambda: harness.status.failed_attempts >= 2)
        assert harness.status.last_error
        assert "Traceback" not in harness.status.last_error
        assert not harness.status.connected
        assert Holdings.of().memory_kib - before.memory_kib < 120 * 1024
        assert len(SENT_MIB) < 40 * connections
    finally:
        await harness.link.stop()
        server.close()
    assert connections >= 2
    await wait_until(lambda: len(asyncio.all_tasks()) == 1)

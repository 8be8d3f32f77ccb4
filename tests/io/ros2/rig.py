"""A daemon in this process, in a DDS domain of its own, and hosts that others have written."""

import asyncio
import contextlib
import functools
import socket

import numpy as np
from mcap_ros2._dynamic import generate_dynamic

from benchmarks.ros2_peers import arguments
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.connections import LINKS
from hilserver.daemon.daemon import Daemon
from hilserver.ros.types import known_types
from tests.loopback.rig import configuration, wait_until

PATIENCE_S = 120.0
NEVER_SILENT_MS = 600_000.0
"""A host on a busy computer may pause; tests of silence set their own limit."""
SILENT_MS = 2000.0


@contextlib.contextmanager
def claimed_domain():
    """Give a DDS domain that no other test on this computer has now."""
    for domain in range(1, 100):
        with socket.socket() as lock:
            try:
                lock.bind(("127.0.0.1", 21_000 + domain))
            except OSError:
                continue
            yield domain
            return
    raise AssertionError("all domains are taken")


@contextlib.asynccontextmanager
async def robot(domain, *, plant=None, beside=None, folder=None, links=LINKS, **ros2):
    """A daemon without OPC UA that takes part in ROS 2; `beside`: its other sections."""
    ours = {
        "enabled": True,
        "domain": domain,
        "stale_after_ms": NEVER_SILENT_MS,
        **ros2,
    }
    sections = {
        "ros2": ours,
        "opcua": {"enabled": False},
        "plant": plant or {},
        **(beside or {}),
    }
    async with Daemon(
        assemble_config(configuration(**sections), folder), links=links
    ) as daemon:
        yield daemon


@functools.cache
def decoder(type_name):
    """Return code that is not ours nor that of rosbags."""
    text, _ = known_types().store.generate_msgdef(type_name, ros_version=2)
    return generate_dynamic(type_name, text)[type_name]


def understood(type_name, cdr):
    return decoder(type_name)(cdr)


class Host:
    """A program of another DDS implementation: reads and writes topics.

    Parameters
    ----------
    endpoints : tuple of (mode, topic, type, reliability)
    """

    def __init__(self, program, domain, *endpoints):
        self._command = [str(program), *arguments(domain, endpoints)]
        self.types = {topic: type_name for _, topic, type_name, _ in endpoints}
        self._numbers = {
            (mode, topic): n for n, (mode, topic, _, _) in enumerate(endpoints)
        }
        self._topics = [topic for _, topic, _, _ in endpoints]
        self.received = {topic: [] for mode, topic, _, _ in endpoints if mode == "r"}

    async def __aenter__(self):
        pipe = asyncio.subprocess.PIPE
        self._process = await asyncio.create_subprocess_exec(
            *self._command, stdin=pipe, stdout=pipe, limit=1 << 20
        )
        ready = asyncio.Event()
        self._reading = asyncio.create_task(self._read(ready))
        await asyncio.wait_for(ready.wait(), PATIENCE_S)
        assert not self._reading.done(), "the host has ended by itself"
        return self

    async def __aexit__(self, *_):
        self._process.stdin.close()
        await asyncio.wait_for(self._process.wait(), PATIENCE_S)
        await self._reading

    async def _read(self, ready):
        async for line in self._process.stdout:
            if line == b"ready\n":
                ready.set()
                continue
            number, _late, _sequence, cdr = line.split()
            self.received[self._topics[int(number)]].append(bytes.fromhex(cdr.decode()))
        ready.set()  # nothing more will come

    def write(self, topic, **fields):
        """Write one message."""
        message = known_types().make(self.types[topic], **fields)
        self.write_cdr(topic, known_types().encode(message))

    def write_cdr(self, topic, cdr):
        self._process.stdin.write(f"{self._numbers['w', topic]} {cdr.hex()}\n".encode())

    async def repeat(self, topic, **fields):
        """Write one message 50 times a second until cancelled."""
        while True:
            self.write(topic, **fields)
            await asyncio.sleep(0.02)

    @contextlib.asynccontextmanager
    async def repeating(self, topic, **fields):
        task = asyncio.create_task(self.repeat(topic, **fields))
        try:
            yield
        finally:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task

    def messages(self, topic):
        """Return every message of a topic."""
        return [understood(self.types[topic], cdr) for cdr in self.received[topic]]

    def last(self, topic):
        """Return the newest message of a topic."""
        return understood(self.types[topic], self.received[topic][-1])

    async def sees(self, topic, condition=lambda _: True):
        """Wait for a message that meets a condition; return it."""
        await wait_until(
            lambda: self.received[topic] and condition(self.last(topic)), PATIENCE_S
        )
        return self.last(topic)


def speeds(fl=0.0, fr=0.0, rl=0.0, rr=0.0):
    return {
        "front_left_rpm": fl,
        "front_right_rpm": fr,
        "rear_left_rpm": rl,
        "rear_right_rpm": rr,
    }


def twist(forward=0.0, turn=0.0):
    make = known_types().make
    vector = "geometry_msgs/msg/Vector3"
    return {
        "linear": make(vector, x=forward, y=0.0, z=0.0),
        "angular": make(vector, x=0.0, y=0.0, z=turn),
    }


def four_floats(*numbers):
    layout = known_types().make("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
    return {"layout": layout, "data": np.array(numbers, dtype=np.float32)}


def value(daemon, name):
    frame = daemon.image.latest()
    return None if frame is None else float(frame.values[daemon.table.slot(name)])
